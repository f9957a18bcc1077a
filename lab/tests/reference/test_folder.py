"""Files are found by the names they were published under; a renamed folder is named with what is there instead."""

import pytest

from echoavatar.errors import CheckpointError
from echoavatar_lab.reference import Release


def test_every_file_is_found(download):
    release = Release(download / "ckpts", download / "stats")
    assert [release.tokenizer(part).name for part in ("lower", "upper", "hands")] == [
        "net_65000.pth",
        "net_54000.pth",
        "net_60000.pth",
    ]
    assert release.codes("upper") == 512
    assert release.face().name == "gpt_80000.pth"
    assert release.generator().name == "body_g_d"
    assert release.generator("body_g").name == "body_g"


def test_of_several_steps_the_last_is_taken(spoilt):
    path = spoilt("ckpts/face/*/gpt_80000.pth")
    (path.parent / "gpt_9000.pth").touch()
    (path.parent / "gpt_100000.pth").touch()
    assert Release(path.parents[2], path.parents[3] / "stats").face().name == "gpt_100000.pth"


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("ckpts/body_rvqvae", "no folder .*body_rvqvae.*has: body_g, body_g_d, face, renamed"),
        ("ckpts/body_rvqvae/*_bp_upper_*", "no folders .*_bp_upper_.*wanted one .*renamed"),
        ("ckpts/face/*FaceGPT*", r"no folders \*FaceGPT\*.*renamed"),
        ("ckpts/body_rvqvae/*/net_65000.pth", "no net_STEP.pth"),
    ],
)
def test_what_was_renamed_is_named(spoilt, pattern, message):
    path = spoilt(pattern)
    root = path.parents[len(pattern.split("/")) - 1]
    path.rename(path.with_name("renamed"))
    release = Release(root / "ckpts", root / "stats")
    with pytest.raises(CheckpointError, match=message):
        _ = [release.tokenizer(part) for part in ("lower", "upper", "hands")], release.face()


def test_missing_generator_and_statistics_are_named(tmp_path):
    with pytest.raises(CheckpointError, match="holds the generator.*nothing"):
        Release(tmp_path, tmp_path).generator()
    with pytest.raises(CheckpointError, match="--stats is the folder"):
        Release(tmp_path, tmp_path).stat("zm_meta_info.npz")
