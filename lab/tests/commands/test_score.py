import json
from pathlib import Path

import numpy as np
import pytest
from lab.tests.datasets.samples import write_beat2
from lab.tests.evaluation.clips import clip, folder
from lab.tests.foreign.test_smpl import Runs, write_edge

from echoavatar.cli import main


@pytest.fixture
def folders(tmp_path: Path) -> list[str]:
    truth = folder(tmp_path / "true", [clip("a"), clip("b", every_s=0.7)])
    made = folder(tmp_path / "made", [clip("a", size=0.2), clip("b", size=0.25)])
    return [str(made), str(truth)]


def test_a_table_then_one_line_of_json(folders: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", *folders, "--picture", str(tmp_path / "a.png")]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    told = json.loads(said[-1])
    assert {line.split()[0].removesuffix("*") for line in said[2:-2]} == told.keys()
    assert told["fid"]["value"] > 0
    assert told["ba_g_emage"]["chance"] is not None
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_json_alone_without_sound_and_extractor(folders: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", *folders, "--no-audio", "--extractor", "none", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert "skate" in told
    assert not {"fid", "ba_g_sharp"} & told.keys()


def test_retrieval_of_embeddings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = np.random.default_rng(0).normal(size=(40, 8))
    np.savez(tmp_path / "pairs.npz", audio=values, motion=values)
    assert main(["score", "--embeddings", str(tmp_path / "pairs.npz"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["a2m_medr_all"]["value"] == 1


def test_errors_are_one_line(folders: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, complaint in (
        (["score"], "give two folders"),
        (["score", folders[0]], "give two folders"),
        (["score", str(tmp_path / "none"), folders[1]], "is not a folder"),
        (["score", *folders, "--extractor", str(tmp_path)], "is not a checkpoint"),
    ):
        assert main(words) == 1
        error = capsys.readouterr().err
        assert complaint in error
        assert error.count("\n") == 1


def test_a_bundle_makes_the_motion_and_the_runtime_heads_the_table(
    tmp_path: Path, tiny_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = folder(tmp_path / "true", [clip("a", 60)], is_corpus=True)
    words = [str(tmp_path / "made"), str(truth), "--extractor", "none", "--no-audio"]
    made = ["--model", str(tiny_bundle), "--runtime", "paper", "--seed", "5"]
    assert main(["score", *words, "--runtime", "paper"]) == 1
    assert "--runtime needs --model" in capsys.readouterr().err
    sound = [word for word in words if word != "--no-audio"]
    assert main(["score", *sound, *made, "--kind", "speech"]) == 0
    assert capsys.readouterr().out.startswith("runtime: paper; model: ")
    assert main(["score", *words]) == 0  # the note stays with the motion
    assert capsys.readouterr().out.startswith("runtime: paper; model: ")


def foreign(place: Path, step: float) -> tuple[Path, Path, Path]:
    """The truth on SMPL-X; as EMAGE writes it, going `step` metres a frame along X; as EDGE writes it, likewise."""
    true, emage, edge = (place / name for name in ("true", "emage", "edge"))
    for folder_of in (true, emage, edge):
        folder_of.mkdir(parents=True)
    for name, seconds in (("a", 2.0), ("b", 3.0)):
        stands = write_beat2(place / "raw", name, seconds)
        (true / f"{name}.npz").write_bytes(stands.read_bytes())
        for z_up in (False, True):
            with np.load(write_beat2(place / f"raw{z_up}", name, seconds, is_z_up=z_up)) as stored:
                arrays = dict(stored)
            arrays["trans"] = arrays["trans"] + np.outer(step * np.arange(len(arrays["trans"])), [1, 0, 0])
            if z_up:
                write_edge(edge / f"test_{name}.pkl", arrays["poses"][:, :72], arrays["trans"])
            else:
                np.savez(emage / f"res_{name}.npz", **arrays)
    return true, emage, edge


def test_files_of_other_systems_get_the_scores_they_were_made_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same poses, one centimetre a frame to the side: poses have no error, steps one of 10 mm."""
    true, *others = foreign(tmp_path, 0.01)
    for made in others:
        assert main(["score", str(made), str(true), "--no-audio", "--extractor", "none", "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["trans_loss"]["value"] == pytest.approx(10.0, rel=0.02), made
        assert told["mpjpe_body"]["value"] == pytest.approx(0.0, abs=1e-3), made
        assert told["hand_speed"]["value"] == pytest.approx(told["hand_speed"]["truth"], rel=1e-4)
        straight = made.name == "edge"  # EDGE has no fingers
        assert (told["mpjpe_hands"]["value"] > 1) == straight


def test_bad_files_of_other_systems_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true, emage, edge = foreign(tmp_path, 0.0)
    with np.load(emage / "res_a.npz") as stored:
        arrays = dict(stored)
    np.savez(emage / "res_a.npz", **arrays | {"poses": np.where(np.arange(60)[:, None] == 7, np.nan, arrays["poses"])})
    write_edge(edge / "test_b.pkl", arrays["poses"][:, :72], arrays["trans"], extra=Runs())
    for made, told in ((emage, "res_a.npz, frame 7: "), (edge, "test_b.pkl is refused: it would run builtins.print")):
        assert main(["score", str(made), str(true), "--no-audio", "--extractor", "none"]) == 1
        said = capsys.readouterr()
        assert told in said.err
        assert said.err.count("\n") == 1
        assert "never run" not in said.out
    np.savez(emage / "res_a.npz", **arrays | {"mocap_frame_rate": 60})
    assert main(["score", str(emage), str(true), "--no-audio", "--extractor", "none"]) == 1
    assert "res_a.npz is at 60 frames per second" in (error := capsys.readouterr().err)
    assert "--resample" in error
