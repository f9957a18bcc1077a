"""Our metrics against the released implementation's, run with random weights (tests/fixtures/golden)."""

import numpy as np
import pytest
from tests import golden as fixtures

from echoavatar_lab.evaluation.metrics.beat_alignment import (
    EMAGE_RATE_HZ,
    GESTURE_RULES,
    SMPLX_UPPER_BODY,
    gesture_alignment,
    gesture_beat_frames,
    hit_rate,
    speech_onsets,
)
from echoavatar_lab.evaluation.metrics.distributions import frechet_distance
from echoavatar_lab.evaluation.metrics.positions import l1_deviation


def stored(name: str) -> dict[str, np.ndarray]:
    return dict(np.load(fixtures.golden(f"reference_release/{name}")))


def test_fid() -> None:
    golden = stored("fid_frechet.npz")
    assert frechet_distance(golden["A"], golden["B"]) == pytest.approx(float(golden["fid"]), rel=1e-6)
    assert frechet_distance(golden["A"], golden["A"]) == pytest.approx(float(golden["fid_self"]), abs=1e-9)


@pytest.mark.parametrize("stretch", ["windowed", "full"])
def test_ba_g(stretch: str) -> None:
    """Beats of every joint exactly, the score to 1e-9, and the onsets of the same librosa exactly."""
    golden = stored("metrics_ba_div.npz")
    off = int(golden["align_mask_frames"]) if stretch == "windowed" else 0
    joints = golden["joints"].reshape(-1, 55, 3)
    found = gesture_beat_frames(joints, GESTURE_RULES["emage"], golden["avg_vel"], window=(off, len(joints) - off))
    assert [len(own) for own in found] == golden[f"beats_{stretch}_len"].tolist()
    assert np.array_equal(np.concatenate(found), golden[f"beats_{stretch}"])
    upper = [found[joint] / 30 for joint in SMPLX_UPPER_BODY]
    ours = gesture_alignment(upper, golden[f"onsets_{stretch}"], "emage")
    assert ours == pytest.approx(float(golden[f"align_{stretch}"]), abs=1e-9)


@pytest.mark.parametrize("stretch", ["windowed", "full"])
def test_onsets(stretch: str) -> None:
    pytest.importorskip("librosa")
    golden = stored("metrics_ba_div.npz")
    audio = golden["wav_int16"].astype(np.float32) / 32768
    off = EMAGE_RATE_HZ if stretch == "windowed" else 0
    found = speech_onsets(audio[off : len(audio) - off], EMAGE_RATE_HZ)
    np.testing.assert_array_equal(found, golden[f"onsets_{stretch}"])


def test_hit_rate_and_diversity() -> None:
    golden = stored("metrics_ba_div.npz")
    ours = hit_rate(np.array([0.5, 1, 2.2]), np.array([0.45, 1.4, 3]), 0.3)
    assert ours == pytest.approx(float(golden["gahr_demo"]), abs=1e-9)
    joints = golden["joints"].reshape(-1, 55, 3)
    spread = np.average([l1_deviation(joints), l1_deviation(joints[:120])], weights=[len(joints), 120])
    assert spread == pytest.approx(float(golden["l1div"]), abs=1e-9)
