import numpy as np
import pytest
import torch
from lab.tests.evaluation.clips import clicks, clip

from echoavatar.errors import AudioError, MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.evaluation.metrics.positions import heading
from echoavatar_lab.kinematics import matrix_from_quaternion
from echoavatar_lab.models.tokenizer.train import as_one_part
from echoavatar_lab.tables.baselines import STRETCH_FRAMES, Baselines, Stretch, facing, spectra


def training() -> list:
    return [clip(f"t{k}", 200, every_s=pace, size=0.1 + 0.1 * k) for k, pace in enumerate((0.3, 0.5, 0.8))]


@pytest.mark.parametrize("kind", ["mean", "random", "nearest"])
def test_motion_is_as_long_as_the_sound(kind: str) -> None:
    made = Baselines(training()).make(kind, clicks(130, 0.4)[:-5])
    assert made.frames == 129
    assert np.abs(np.linalg.norm(made.rotations, axis=-1) - 1).max() < 1e-5


def test_the_mean_pose_stands_still_between_the_poses() -> None:
    """Swaying to and fro about rest: the mean is rest."""
    made = Baselines(training()[:1]).make("mean", clicks(30, 0.4))
    assert np.ptp(made.rotations, axis=0).max() == 0
    assert np.abs(made.rotations[0, :, 0]).min() > 0.99


def test_a_random_clip_is_one_and_follows_the_seed() -> None:
    clips = training()
    made = [Baselines(clips).make("random", clicks(150, 0.4), seed=seed) for seed in (3, 3, 4)]
    np.testing.assert_array_equal(made[0].rotations, made[1].rotations)
    assert not np.array_equal(made[0].rotations, made[2].rotations)
    joint = made[0].rotations[:, 5]
    assert any(
        np.array_equal(joint, one.rotations[s : s + 150, 5]) for one in clips for s in range(len(one.root) - 149)
    )


def test_sound_of_the_training_data_finds_its_own_motion() -> None:
    """Frames 64 to 192 of the second clip, which lie on the search's grid."""
    clips = training()
    audio = clips[1].audio[64 * 800 : 192 * 800]
    assert Baselines(clips).nearest(audio) == [Stretch(1, 64, 128), Stretch(1, 128, 192)]


def test_stretches_are_joined_without_a_jump_in_place_or_heading() -> None:
    clips = training()
    made = Baselines(clips).joined([Stretch(0, 0, 50), Stretch(2, 100, 150), Stretch(1, 7, 57)])
    yaw = heading(matrix_from_quaternion(torch.from_numpy(made.rotations[:, 0]))).numpy()
    inside = max(np.abs(np.diff(np.unwrap(yaw[a:b]))).max() for a, b in ((0, 50), (50, 100), (100, 150)))
    assert np.abs(np.diff(np.unwrap(yaw))).max() <= inside + 1e-4
    assert np.linalg.norm(np.diff(made.root[:, [0, 2]], axis=0), axis=-1)[[49, 99]].max() < 1e-5


def test_turning_a_clip_turns_its_way_too() -> None:
    """A body that walks ahead goes on walking ahead, a quarter turn to its left: from +Z to +X."""
    one = training()[0]
    still, root = one.rotations.copy(), one.root.copy()
    still[:] = [1, 0, 0, 0]
    root[:, 0], root[:, 2] = 0, np.arange(len(root)) * 0.02
    turned, moved = facing(still, root, np.pi / 2)
    np.testing.assert_allclose(moved[:, 0], root[:, 2], atol=1e-4)
    assert heading(matrix_from_quaternion(torch.from_numpy(turned[:1, 0]))).item() == pytest.approx(np.pi / 2)


def test_spectra_are_one_a_frame_and_what_is_missing_is_named() -> None:
    assert spectra(clicks(90, 0.5)).shape[0] == 90
    with pytest.raises(MotionError, match="no training clips"):
        Baselines([])
    with pytest.raises(AudioError, match="less than a frame"):
        Baselines(training()).make("mean", np.zeros(799, np.float32))
    with pytest.raises(MotionError, match=f"{STRETCH_FRAMES} frames"):
        Baselines([clip("short", 30)]).make("nearest", clicks(30, 0.5))


def test_baselines_stay_on_the_rig_of_their_clips() -> None:
    rig = as_one_part(HUMANOID)
    for kind in ("mean", "random"):
        assert Baselines(training(), rig).make(kind, clicks(64, 0.4)).skeleton is rig
