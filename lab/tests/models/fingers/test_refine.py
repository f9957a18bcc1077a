import numpy as np
import pytest
from lab.tests.models.fingers.moving import waving, without

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_axis_angle, quaternion_from_matrix
from echoavatar_lab.evaluation.fingers import curl
from echoavatar_lab.models.fingers.clips import FINGERS, on_our_rig
from echoavatar_lab.models.fingers.model import FingerModel
from echoavatar_lab.models.fingers.refine import (
    apply_fingers,
    at_rate,
    finger_joints,
    frozen_hands,
    refine_fingers,
    smoothed,
)


def foreign(motion: Motion) -> Motion:
    """The same motion on a rig whose finger bones are rotated by half a radian at rest."""
    rig = motion.skeleton
    tilt = matrix_from_axis_angle(np.array([0.0, 0.3, 0.4]))
    local, offsets = motion.matrices(), rig.offsets.copy()
    for joint in finger_joints(motion, "left").values():
        is_first = rig.names[rig.parents[joint]] == "leftHand"
        local[:, joint] = local[:, joint] if is_first else tilt.T @ local[:, joint]
        local[:, joint] = local[:, joint] @ tilt
        offsets[joint] = offsets[joint] if is_first else tilt.T @ offsets[joint]
    config = rig.config.model_copy(update={"offsets": tuple(tuple(map(float, row)) for row in offsets)})
    config = config.model_copy(update={"names": tuple(f"r{name}" for name in rig.names), "tips": {}})
    turned = quaternion_from_matrix(local)
    return Motion(Skeleton(config), turned, motion.root, motion.fps)


def test_fingers_carried_over_and_put_back_are_the_same() -> None:
    """Retargeted fingers applied to the rig they came from change nothing."""
    motion = foreign(waving(30))
    fingers = on_our_rig(motion).matrices()[:, list(FINGERS)]
    back = apply_fingers(motion, fingers, ("left", "right"))
    assert angle_between(back.matrices(), motion.matrices()).max() < 1e-3


def test_only_the_asked_hand_changes_and_missing_bones_are_passed_over() -> None:
    motion = without(waving(30), "Little", "RingDistal")
    fingers = matrix_from_axis_angle(0.3 * np.random.default_rng(0).standard_normal((30, 30, 3)))
    made = apply_fingers(motion, fingers, ("right",))
    changed = {
        name
        for joint, name in enumerate(motion.skeleton.names)
        if (made.rotations[:, joint] != motion.rotations[:, joint]).any()
    }
    assert changed == set(finger_joints(motion, "right"))
    assert len(changed) == 11


def test_an_unknown_rig_is_refused() -> None:
    config = waving(1).skeleton.config.model_copy(
        update={"vrm": {}, "names": tuple(f"j{i}" for i in range(52)), "offsets": ((0.0,) * 3,) * 52}
    )
    motion = Motion(Skeleton(config), waving(1).rotations, waving(1).root, 30.0)
    with pytest.raises(MotionError, match="is not known"):
        finger_joints(motion, "left")


FINGER_JOINTS = list(FINGERS)


def test_hands_close_as_arms_rise_on_a_body_never_seen(model: FingerModel) -> None:
    """The tiny model was trained on eight such bodies; this one moves at other paces and comes with flat hands."""
    truth = waving(200, seed=99)
    made = refine_fingers(model, waving(200, seed=99, still=("left", "right")), seed=3)
    a, b = (curl(m.matrices()[:, FINGER_JOINTS]) for m in (truth, made))
    for side in (0, 1):
        assert np.corrcoef(a[:, side], b[:, side])[0, 1] > 0.8


def test_only_fingers_of_the_asked_hand_change(model: FingerModel) -> None:
    motion = waving(40)
    made = refine_fingers(model, motion, hands="left")
    changed = (made.rotations != motion.rotations).any((0, 2)).nonzero()[0].tolist()
    assert set(changed) <= set(FINGER_JOINTS[:15])
    assert len(changed) >= 12  # the thumbs of these bodies rest
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
    assert np.abs(b[at] - a[::5][: len(at)]).max() < (0.02 if fps == 24 else 2e-3)
    assert other.frames == round(90 * fps / 30) + 1


def test_frozen_hands_are_found_and_the_others_kept(model: FingerModel) -> None:
    half = waving(40, still=("right",))
    assert frozen_hands(half) == ("right",)
    made = refine_fingers(model, half, hands="frozen")
    changed = (made.rotations != half.rotations).any((0, 2)).nonzero()[0].tolist()
    assert set(changed) <= set(FINGER_JOINTS[15:])
    assert len(changed) >= 12
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
    assert np.abs(smoothed(curve) - curve).max() < 1e-5
    jitter = curve + 0.1 * (-1.0) ** np.arange(50)[:, None, None].astype(np.float32)
    assert np.abs(smoothed(jitter) - curve)[5:-5].max() < 0.03
    assert np.array_equal(smoothed(curve[:2]), curve[:2])


def test_smoothing_reaches_over_three_tenths_of_a_second() -> None:
    """What a single pose of 30 a second changes, itself among it."""
    poses = np.zeros((61, 2, 3), np.float32)
    poses[30] = 1
    changed = np.flatnonzero(smoothed(poses)[:, 0, 0])
    assert (len(changed) / 30, changed.mean()) == (pytest.approx(0.3), 30)


def test_rates_hold_the_last_pose() -> None:
    poses = np.tile(np.arange(4.0)[:, None, None], (1, 2, 3))
    fast = at_rate(poses, 60.0, 9)
    np.testing.assert_allclose(fast[:, 0, 0], [0, 0.5, 1, 1.5, 2, 2.5, 3, 3, 3])
