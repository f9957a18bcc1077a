import pytest
import torch
from tests.models.face.tiny import JAW, clip

from echoavatar.errors import MotionError
from echoavatar_lab.models.face.windows import FaceSampler


def test_windows_are_the_same_for_the_same_step_and_sound_fits_the_face():
    sampler = FaceSampler([clip()], frames=16, seed=3)
    one, two = sampler.batch(7, 4), sampler.batch(7, 4)
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
    assert not torch.equal(one.curves, sampler.batch(8, 4).curves)
    loud = one.audio.unflatten(1, (16, 800)).square().mean(2).sqrt()
    assert torch.corrcoef(torch.stack([loud.flatten(), one.curves[..., JAW].flatten()]))[0, 1] > 0.9


def test_clips_too_short_for_a_window_are_named():
    with pytest.raises(MotionError, match="longer than 300 frames"):
        FaceSampler([clip()], frames=300, seed=0)


def test_speeds_are_those_asked_for():
    """At one speed every window lies in the clip as it is; faster, most do not."""
    truth = torch.from_numpy(clip().audio)

    def found(speed: float) -> int:
        batch = FaceSampler([clip()], frames=16, seed=3, speeds=(speed,)).batch(0, 20)
        return sum(bool((truth.unfold(0, 12_800, 800) == window).all(1).any()) for window in batch.audio)

    assert found(1.0) == 20
    assert found(1.1) < 15


def test_a_late_face_is_that_of_the_frame_before_and_the_sound_stays():
    now, late = (FaceSampler([clip()], frames=16, seed=3, late=frames).batch(0, 6) for frames in (0, 2))
    assert torch.equal(now.audio, late.audio)
    assert torch.equal(now.curves[:, 1:-2], late.curves[:, 3:])
    assert torch.equal(now.before, late.curves[:, 1])
