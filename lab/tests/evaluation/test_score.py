from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.clips import MUSIC, clip, folder
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
from echoavatar_lab.evaluation.motion_folder import Pair, ReadOptions, read_pairs
from echoavatar_lab.evaluation.score import UNITS, measure_clip, score


def pairs(tmp_path: Path, made_size: float) -> list[Pair]:
    names = {"a": 0.4, "b": 0.5, "c": 0.6}
    truth = [clip(name, every_s=pace, kind=MUSIC if name == "c" else 1) for name, pace in names.items()]
    made = [clip(name, size=made_size) for name in names]
    where = folder(tmp_path / f"made{made_size}", made), folder(tmp_path / "true", truth)
    return read_pairs(*where, ReadOptions())


def test_the_truth_has_no_errors_and_scores_as_itself(tmp_path: Path) -> None:
    pytest.importorskip("librosa", reason="the evaluate extra is not installed")
    told: list[int] = []
    rows = {r.name: r for r in score(pairs(tmp_path, 0.3), load_shipped(), progress=lambda n, _: told.append(n))}
    assert told == [1, 2, 3]
    assert rows["fid"].value == pytest.approx(0, abs=1e-3)
    for name in ("mpjpe_body", "mpjpe_hands", "trans_loss"):
        assert rows[name].value == pytest.approx(0, abs=1e-3)
    for name in (*UNITS, "ba_g_sharp", "ba_d_sharp"):
        assert rows[name].value == pytest.approx(rows[name].truth)
    assert rows["ba_g_sharp"].chance == pytest.approx(rows["ba_g_sharp"].truth_chance)


def test_a_livelier_body_shows_in_every_row_it_should(tmp_path: Path) -> None:
    """Without sound only what motion alone tells; twice the swing is twice the diversity and jerk, roughly."""
    silent = [Pair(p.name, p.made, p.true, None, p.domain) for p in pairs(tmp_path, 0.15)]
    rows = {row.name: row for row in score(silent, load_shipped())}
    assert not any(name.startswith("ba_") for name in rows)
    assert rows["l1_diversity"].value < 0.7 * rows["l1_diversity"].truth
    assert rows["jerk"].value < 0.7 * rows["jerk"].truth
    assert rows["mpjpe_body"].value > 5
    assert rows["fid"].value > 1
    assert rows["fid"].interval.low <= rows["fid"].value <= rows["fid"].interval.high
    assert "fid" not in {row.name for row in score(silent, None)}


def test_floor_depth_is_measured_from_the_standing_height() -> None:
    still = np.zeros((30, HUMANOID.joints, 4), np.float32)
    still[..., 0] = 1
    root = np.tile(HUMANOID.rest_positions[0].numpy(), (30, 1)).astype(np.float32)
    assert measure_clip(Motion(HUMANOID, still, root, 30.0)).numbers["floor_depth"] == pytest.approx(0, abs=1e-3)
    root[:, 1] -= 0.03
    assert measure_clip(Motion(HUMANOID, still, root, 30.0)).numbers["floor_depth"] == pytest.approx(3, abs=1e-3)


def test_nothing_and_too_little_are_named() -> None:
    with pytest.raises(MotionError, match="no clip"):
        score([], None)
    short = swaying(7)
    with pytest.raises(MotionError, match="clip x has 7 frames"):
        score([Pair("x", short, short, None, np.zeros(7, np.uint8))], None)
