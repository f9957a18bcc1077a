import numpy as np
import pytest
import torch
from tests.models.fingers.moving import waving, without

from echoavatar.errors import MotionError
from echoavatar.models.fingers import FingerModel, frozen_hands, refine_fingers
from echoavatar.models.fingers.hand_poses import FINGERS
from echoavatar.models.fingers.refine import at_rate, smoothed
from echoavatar.motion.kinematics.motion import resample
from echoavatar_lab.evaluation.fingers import curl

FINGER_JOINTS = list(FINGERS)


def test_hands_close_as_arms_rise_on_a_body_never_seen(model: FingerModel) -> None:
    """The tiny model was trained on eight such bodies; this one moves at other paces and comes with flat hands."""
    truth = waving(200, seed=99)
    made = refine_fingers(model, waving(200, seed=99, still=("left", "right")), seed=3)
    a, b = (curl(m.matrices()[:, FINGER_JOINTS]) for m in (truth, made))
    for side in (0, 1):
        assert torch.corrcoef(torch.stack([a[:, side], b[:, side]]))[0, 1] > 0.8


def test_only_fingers_of_the_asked_hand_change(model: FingerModel) -> None:
    motion = waving(40)
    made = refine_fingers(model, motion, hands="left")
    changed = (made.rotations != motion.rotations).any((0, 2)).nonzero()[0].tolist()
    assert changed == FINGER_JOINTS[:15]
    assert np.array_equal(made.root, motion.root)


@pytest.mark.parametrize("frames", [1, 2, 5, 17])
def test_clips_of_any_length_are_refined(model: FingerModel, frames: int) -> None:
    made = refine_fingers(model, waving(frames))
    assert made.frames == frames
    assert np.abs(np.linalg.norm(made.rotations, axis=-1) - 1).max() < 1e-5


@pytest.mark.parametrize("fps", [24.0, 60.0, 120.0])
def test_other_rates_give_the_same_fingers_at_the_same_times(model: FingerModel, fps: float) -> None:
    """120 to 30 and back: at the shared instants (and for 24 fps nearby) the curl is that of the 30 fps clip."""
    plain = refine_fingers(model, waving(91), steps=2)
    other = refine_fingers(model, resample(waving(91), fps), steps=2)
    a, b = (curl(m.matrices()[:, FINGER_JOINTS]) for m in (plain, other))
    at = np.round(np.arange(0, 90, 5) * fps / 30).astype(int)
    assert (b[at] - a[::5][: len(at)]).abs().max() < (0.02 if fps == 24 else 2e-3)
    assert other.frames == round(90 * fps / 30) + 1


def test_frozen_hands_are_found_and_the_others_kept(model: FingerModel) -> None:
    half = waving(40, still=("right",))
    assert frozen_hands(half) == ("right",)
    made = refine_fingers(model, half, hands="frozen")
    changed = (made.rotations != half.rotations).any((0, 2)).nonzero()[0].tolist()
    assert changed == FINGER_JOINTS[15:]
    alive = waving(40)
    assert refine_fingers(model, alive, hands="frozen") is alive


def test_a_rig_without_fingers_is_refused_and_one_with_some_is_not(model: FingerModel) -> None:
    digits = ("Thumb", "Index", "Middle", "Ring", "Little")
    with pytest.raises(MotionError, match="no finger bones"):
        refine_fingers(model, without(waving(10), *digits))
    one = without(waving(10), *(f"left{digit}" for digit in digits))
    with pytest.raises(MotionError, match="no fingers on its left hand"):
        refine_fingers(model, one, hands="left")
    assert not np.array_equal(refine_fingers(model, one).rotations, one.rotations)
    assert refine_fingers(model, without(waving(10), "Little", "Distal")).frames == 10


def test_smoothing_keeps_parabolas_and_takes_jitter() -> None:
    time = np.linspace(-1, 1, 50)
    curve = np.tile((time**2)[:, None, None], (1, 2, 3)).astype(np.float32)
    assert np.abs(smoothed(curve).numpy() - curve).max() < 1e-5
    jitter = curve + 0.1 * (-1.0) ** np.arange(50)[:, None, None].astype(np.float32)
    assert np.abs(smoothed(jitter).numpy() - curve)[5:-5].max() < 0.03
    assert np.array_equal(smoothed(curve[:2]).numpy(), curve[:2])


def test_rates_hold_the_last_pose() -> None:
    poses = torch.arange(4.0)[:, None, None].expand(4, 2, 3)
    fast = at_rate(poses, 60.0, 9)
    torch.testing.assert_close(fast[:, 0, 0], torch.tensor([0, 0.5, 1, 1.5, 2, 2.5, 3, 3, 3]))
