"""The command as a user meets it, on made-up recordings and, where they are, on the real ones."""

import json

import pytest
from lab.tests.datasets.samples import SHARED, write_beat2, write_pair

from echoavatar.cli import main
from echoavatar_lab.data import Corpus


@pytest.fixture
def takes(tmp_path):
    folder = tmp_path / "takes"
    for name in ("a", "b", "c"):
        write_pair(folder / f"{name}.bvh", 1.0)
    return folder


def prepare(*words: object) -> int:
    return main(["data", "prepare", *map(str, words), "--workers", "1", "--no-pictures"])


def test_help_teaches(capsys):
    with pytest.raises(SystemExit):
        main(["data", "prepare", "--help"])
    said = capsys.readouterr().out
    for word in ("zeroeggs", "smplxflame_30", "--dry-run", "train tokenizer sets/zeroeggs", "docs/datasets.md"):
        assert word in said


def test_a_dry_run_tells_and_writes_nothing(takes, tmp_path, capsys):
    (takes / "b.wav").unlink()
    assert prepare("bvh", takes, "-o", tmp_path / "set", "--dry-run") == 0
    said = capsys.readouterr().out
    assert "train: 2 clips, 0.0 minutes" in said
    assert "nothing was written" in said
    assert "would fail:" in said
    assert "b.wav is missing" in said
    assert not (tmp_path / "set").exists()
    assert prepare("bvh", takes, "-o", tmp_path / "set", "--dry-run", "--strict") == 1


def test_failures_are_in_the_final_table_and_strict_counts_them(takes, tmp_path, capsys):
    (takes / "b.bvh").write_text("HIERARCHY\n")
    assert prepare("bvh", takes, "-o", tmp_path / "set", "--fingers", "keep") == 0
    said = capsys.readouterr().out
    assert "2 prepared, 0 kept from before, 1 failed" in said
    table = said[said.index("\nfailed:") :]
    assert table.splitlines()[2].startswith("  b  ")
    assert "b.bvh" in table
    assert prepare("bvh", takes, "-o", tmp_path / "set", "--fingers", "keep", "--strict") == 1
    assert "0 prepared, 2 kept from before, 1 failed" in capsys.readouterr().out


def test_a_map_says_which_joint_is_which(takes, tmp_path, capsys):
    given = tmp_path / "map.json"
    given.write_text('{"leftHand": "elsewhere"}')
    assert prepare("bvh", takes, "-o", tmp_path / "set", "--fingers", "keep", "--map", given) == 1
    assert "leftHand is 'elsewhere', and the rig has no such joint" in capsys.readouterr().err
    given.write_text('{"leftHand": "leftHand", "upperChest": null}')
    assert prepare("bvh", takes, "-o", tmp_path / "set", "--fingers", "keep", "--map", given) == 0
    assert "3 prepared" in capsys.readouterr().out
    assert Corpus(tmp_path / "set").manifest.info["options"]["joints"] == {"leftHand": "leftHand", "upperChest": None}
    assert prepare("bvh", takes, "-o", tmp_path / "set", "--fingers", "keep") == 1
    assert "joints" in capsys.readouterr().err


def test_nothing_prepared_is_an_error(takes, tmp_path, capsys):
    for path in takes.glob("*.wav"):
        path.unlink()
    assert prepare("bvh", takes, "-o", tmp_path / "set") == 1
    assert "none of 3 recordings could be prepared" in capsys.readouterr().err


def test_tokens_want_both_models(takes, tmp_path, capsys):
    assert prepare("bvh", takes, "-o", tmp_path / "set", "--codec", tmp_path) == 1
    assert "both --codec and --tokenizer" in capsys.readouterr().err


def test_a_set_is_tokenised_with_any_tokenizer(tmp_path, tiny_bundle, capsys):
    write_pair(tmp_path / "takes" / "a.bvh", 1.0)
    models = ["--codec", tiny_bundle / "codec", "--tokenizer", tiny_bundle / "tokenizer"]
    assert prepare("bvh", tmp_path / "takes", "-o", tmp_path / "set", "--fingers", "keep", *models) == 0
    assert "2 token files" in capsys.readouterr().out
    words = ["train", "tokens", tmp_path / "set", "-o", tmp_path / "tokens", *models]
    assert main([str(word) for word in words]) == 0
    for folder in (tmp_path / "set" / "tokens", tmp_path / "tokens"):
        assert sorted(path.name for path in folder.iterdir()) == ["a.mirror.npz", "a.npz"]


def test_speakers_of_beat2_are_chosen(tmp_path, capsys):
    folder = tmp_path / "beat_english_v2.0.0"
    for name in ("1_wayne_0_1_1", "2_scott_0_1_1"):
        write_beat2(folder, name, 1.0)
    (folder / "train_test_split.csv").write_text("id,type\n1_wayne_0_1_1,train\n2_scott_0_1_1,val\n")
    assert prepare("beat2", folder, "-o", tmp_path / "set", "--speakers", "scott", "--fingers", "keep") == 0
    corpus = Corpus(tmp_path / "set")
    assert corpus.names() == ["2_scott_0_1_1"]
    assert corpus.entry("2_scott_0_1_1").split == "val"
    assert "left out, not among --speakers: 1 (1_wayne_0_1_1)" in capsys.readouterr().out


@pytest.mark.skipif(
    not SHARED.exists(), reason="needs ../shared/data, which only a checkout with the authors' recordings has"
)
def test_the_real_samples(tmp_path, capsys):
    assert prepare("zeroeggs", SHARED / "zeroeggs_cc_by_nc_nd", "-o", tmp_path / "z", "--test-every", 0) == 0
    said = capsys.readouterr().out
    assert "missing from this copy: 66 of 67 recordings: 001-066" in said
    assert "train 1 (1.1 min), 1 mirror images" in said
    bandai = SHARED / "bandai_namco_cc_by_nc"
    assert prepare("bandai", bandai, "-o", tmp_path / "b", "--only", "*_bow_n*", "--fingers", "keep") == 0
    corpus = Corpus(tmp_path / "b")
    corpus.verify()
    assert len(corpus.names(has_mirrored=False)) == 2
    assert not any(entry.has_sound for entry in corpus.entries())
    report = json.loads((tmp_path / "b" / "report.json").read_text())
    assert not report["failed"]
    assert min(one["contacts_agree"] for one in report["fidelity"].values()) > 0.9
    assert max(one["hands_together_error"] for one in report["fidelity"].values()) < 0.03
