"""Files are found by the names they were published under; a renamed folder is named with what is there instead."""

import pytest
import torch
from lab.tests.foreign.test_foreign_files import Bomb

from echoavatar.errors import CheckpointError
from echoavatar_lab.reference import Release, inspect_release


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


def problems(root) -> list[str]:
    return inspect_release(Release(root / "ckpts", root / "stats")).problems


def change(path, edit) -> None:
    """Load, edit and store a torch file of our own making."""
    (key,) = (name for name in ("net", "gpt") if name in torch.load(path, weights_only=True))  # noqa: TID251
    weights = torch.load(path, weights_only=True)[key]  # noqa: TID251
    edit(weights)
    torch.save({key: weights}, path)


def test_a_whole_download_has_a_line_for_every_tensor_and_no_problem(download):
    found = inspect_release(Release(download / "ckpts", download / "stats"))
    assert found.problems == []
    targets = [line.target for line in found.lines]
    assert sum(target.startswith("tokenizer: parts.") for target in targets) == 3 * 92
    assert any("not used" in target for target in targets)
    assert "generator: lm_head.weight (11270 rows)" in targets


def test_a_missing_tensor(spoilt):
    path = spoilt("ckpts/body_rvqvae/*_bp_upper_*/net_54000.pth")
    change(path, lambda net: net.pop("decoder.1.attn.proj.bias"))
    assert problems(path.parents[3]) == [f"{path}: decoder.1.attn.proj.bias [16] is missing"]


def test_a_wrong_shape_and_an_unknown_tensor(spoilt):
    path = spoilt("ckpts/face/*/gpt_80000.pth")
    change(path, lambda gpt: gpt.update({"output_proj.weight": torch.zeros(52, 63), "extra": torch.zeros(2)}))
    assert problems(path.parents[3]) == [
        f"{path}: extra [2] is unknown",
        f"{path}: output_proj.weight is [52, 63], wanted [52, 64]",
    ]


def test_a_malicious_pickle(spoilt, tmp_path):
    path = spoilt("ckpts/body_rvqvae/*_bp_lower_*/net_65000.pth")
    torch.save({"net": {"input_liner.bias": Bomb(tmp_path / "run")}}, path)
    (problem,) = problems(path.parents[3])
    assert str(path) in problem
    assert "mkdir" in problem
    assert not (tmp_path / "run").exists()


def test_a_truncated_file_and_a_renamed_folder_at_once(spoilt):
    path = spoilt("ckpts/face/*/gpt_80000.pth")
    path.write_bytes(path.read_bytes()[:5000])
    home = path.parents[1]
    (home.parent / "body_g").rename(home.parent / "generator")
    (home.parent / "body_g_d").rename(home.parent / "generator_dance")
    first, second = problems(path.parents[3])
    assert "no folder" in first
    assert "body_g_d, which holds the generator" in first
    assert f"{path} is damaged, cut off" in second


def test_what_hinders_all_else_is_said_once(spoilt):
    path = spoilt("ckpts/body_rvqvae/*_bp_hands_*/net_60000.pth")
    change(path, lambda net: net.pop("input_liner.bias"))
    (problem,) = problems(path.parents[3])
    assert "input_liner.bias" in problem


def test_names_of_an_older_torch_are_known(spoilt):
    path = spoilt("ckpts/face/*/gpt_80000.pth")
    stem = "audio_encoder.encoder.pos_conv_embed.conv."

    def older(gpt):
        gpt[f"{stem}weight_g"] = gpt.pop(f"{stem}parametrizations.weight.original0")
        gpt[f"{stem}weight_v"] = gpt.pop(f"{stem}parametrizations.weight.original1")
        del gpt["audio_encoder.masked_spec_embed"]

    change(path, older)
    assert problems(path.parents[3]) == []
