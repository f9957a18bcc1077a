from pathlib import Path

import pytest
from lab.tests.evaluation.clips import clip, folder

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import MotionError
from echoavatar.motion.formats.tables import read_npz
from echoavatar_lab.evaluation.motion_folder import ReadOptions, read_pairs
from echoavatar_lab.evaluation.score_model import made_how, make_motion


def test_every_true_clip_gets_motion_for_its_sound_and_a_note(tmp_path: Path, tiny_bundle: Path) -> None:
    true = folder(tmp_path / "true", [clip("a", 60), clip("b", 90)], is_corpus=True)
    pipeline, note = Pipeline(load_bundle(tiny_bundle).running("paper")), {"runtime": "paper", "seed": 3}
    made = tmp_path / "made"
    assert make_motion(pipeline, note, true, made, ReadOptions(), seed=3) == 2
    assert [pair.made.frames for pair in read_pairs(made, true, ReadOptions())] == [60, 90]
    assert made_how(made) == note
    before = (made / "b.npz").read_bytes()
    (made / "a.npz").unlink()
    assert make_motion(pipeline, note, true, made, ReadOptions(), seed=3) == 1  # goes on
    assert (made / "b.npz").read_bytes() == before
    assert read_npz(made / "a.npz").frames == 60


def test_motion_that_was_made_otherwise_is_never_mixed(tmp_path: Path, tiny_bundle: Path) -> None:
    true = folder(tmp_path / "true", [clip("a", 30)], is_corpus=True)
    pipeline = Pipeline(load_bundle(tiny_bundle).running("paper"))
    make_motion(pipeline, {"runtime": "paper"}, true, tmp_path / "made", ReadOptions())
    with pytest.raises(MotionError, match="made was made with .*paper.*default"):
        make_motion(pipeline, {"runtime": "default"}, true, tmp_path / "made", ReadOptions())
    others = folder(tmp_path / "others", [clip("a", 30)])
    with pytest.raises(MotionError, match=r"without made\.json"):
        make_motion(pipeline, {"runtime": "paper"}, true, others, ReadOptions())
    assert made_how(others) is None
    (tmp_path / "made/made.json").write_text("{")
    with pytest.raises(MotionError, match="damaged"):
        made_how(tmp_path / "made")
