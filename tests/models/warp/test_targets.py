import numpy as np
import pytest
import torch
from tests.models.warp.tiny import clicks

from echoavatar.errors import MotionError
from echoavatar.models.warp.targets import WarpSampler, brake_curve


def test_a_dip_lies_behind_its_event_and_neighbours_do_not_add_up() -> None:
    curve = brake_curve({"stress": np.array([1.0]), "beats": np.array([2.0, 2.01])}, 90)
    assert curve.argmax() == 36  # 0.2 s behind the stress, at 30 fps
    assert curve[36] == pytest.approx(1)
    assert curve[34] == pytest.approx(np.exp(-0.5), rel=1e-5)
    assert 60 + curve[60:].argmax() == 63  # 0.107 s behind the beat
    assert curve.max() <= 1
    assert brake_curve({"downbeats": np.array([1.0])}, 60).max() == 0


def test_a_window_has_the_curve_of_its_own_sound() -> None:
    """Without noise and at one gain, a click in the sound must stand before each dip, wherever the window begins."""
    sampler = WarpSampler([clicks()], frames=128, seed=0, gain_db=0.0)
    batch = sampler.batch(3, 4)
    assert batch.audio.shape == (4, 128 * 800)
    assert batch.brake.shape == (4, 128)
    for audio, brake in zip(batch.audio, batch.brake, strict=True):
        loud = audio.view(128, 800).abs().amax(1)
        peaks = [i for i in range(8, 126) if brake[i] > 0.9 and brake[i] >= brake[i - 1 : i + 2].max()]
        assert peaks
        for peak in peaks:
            assert loud[peak - 5 : peak - 1].max() > 5 * loud.median()


def test_the_same_seed_and_step_give_the_same_windows() -> None:
    clips = [clicks(seed=1), clicks(seed=2)]
    one, two = (WarpSampler(clips, frames=64, seed=4, gain_db=6.0).batch(7, 3) for _ in range(2))
    assert torch.equal(one.audio, two.audio)
    assert not torch.equal(one.audio, WarpSampler(clips, frames=64, seed=5, gain_db=6.0).batch(7, 3).audio)


def test_clips_without_events_or_too_short_are_refused() -> None:
    with pytest.raises(MotionError, match="no clip of at least 128 frames has stresses or beats"):
        WarpSampler([clicks(frames=120)], frames=128, seed=0, gain_db=0.0)
    with pytest.raises(MotionError, match="data rehearse"):
        WarpSampler([clicks(kind="downbeats")], frames=128, seed=0, gain_db=0.0)
