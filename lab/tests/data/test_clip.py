from dataclasses import replace

import numpy as np
import pytest
import torch

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Skeleton, to_features
from echoavatar_lab.data import Clip
from echoavatar_lab.data.clip import is_symmetric, mirror_features, mirror_positions, mirror_quaternions
from echoavatar_lab.kinematics import forward_kinematics, matrix_from_quaternion


def clip(frames: int = 6, name: str = "one", split: str = "train", seed: int = 0) -> Clip:
    generator = np.random.default_rng(seed)
    turns = generator.normal(size=(frames, 52, 4)).astype(np.float32)
    return Clip(
        name=name,
        audio=generator.uniform(-1, 1, 800 * frames).astype(np.float32),
        rotations=turns / np.linalg.norm(turns, axis=-1, keepdims=True),
        root=generator.normal(size=(frames, 3)).astype(np.float32),
        domain=generator.integers(0, 3, frames).astype(np.uint8),
        events={"beats": np.array([0.1, 0.15])},
        split=split,
    )


def test_a_clip_comes_back(tmp_path):
    """Sound within half a step of 16-bit PCM, everything else exactly."""
    first = clip()
    first.save(tmp_path / "clips" / "one.npz")
    back = Clip.load(tmp_path / "clips" / "one.npz")
    assert (back.name, back.split, back.frames) == ("one", "train", 6)
    assert back.seconds == pytest.approx(0.2)
    np.testing.assert_allclose(back.audio, first.audio, atol=0.51 / 32767)
    assert back.audio.dtype == np.float32
    for field in ("rotations", "root", "domain"):
        assert np.array_equal(getattr(back, field), getattr(first, field))
    assert back.events.keys() == {"beats"}
    assert np.array_equal(back.events["beats"], first.events["beats"])


def test_too_loud_samples_are_clipped(tmp_path):
    loud = replace(clip(), audio=np.full(4800, 1.5, np.float32))
    loud.save(tmp_path / "a.npz")
    assert np.abs(Clip.load(tmp_path / "a.npz").audio).max() == pytest.approx(1.0)


def test_saving_twice_gives_the_same_bytes(tmp_path):
    for name in ("a.npz", "b.npz"):
        clip().save(tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a.npz", "b.npz"}


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"audio": np.zeros(4799, np.float32)}, "800 samples a frame"),
        ({"audio": np.full(4800, np.nan, np.float32)}, "audio is not finite"),
        ({"root": np.zeros((5, 3), np.float32)}, "root has shape"),
        ({"rotations": np.zeros((6, 52, 3), np.float32)}, "expected \\(frames, joints, 4\\)"),
        ({"rotations": np.zeros((6, 52, 4), np.float32)}, "not unit quaternions"),
        ({"domain": np.full(6, 3, np.uint8)}, "domain goes to 3"),
        ({"domain": np.zeros(7, np.uint8)}, "domain has shape"),
        ({"split": "dev"}, "split is 'dev'"),
    ],
)
def test_invalid_clips_are_refused(change, complaint):
    with pytest.raises(MotionError, match=f"clip 'one': .*{complaint}"):
        replace(clip(), **change)


def test_no_frames_is_refused():
    with pytest.raises(MotionError, match="no frames"):
        clip(0)


def test_damaged_files_are_explained(tmp_path):
    path = tmp_path / "one.npz"
    with pytest.raises(MotionError, match="does not exist"):
        Clip.load(path)
    clip().save(path)
    whole = path.read_bytes()
    for content in (b"", b"text", whole[:1000], whole[:-40], whole[:2000] + b"x" * 40 + whole[2040:]):
        path.write_bytes(content)
        with pytest.raises(MotionError, match="damaged|not a clip"):
            Clip.load(path)
    np.savez(path, name="one", split="train", audio=np.zeros(1))
    with pytest.raises(MotionError, match="lacks"):
        Clip.load(path)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(MotionError, match="not a clip"):
        Clip.load(path)


def random_clip():
    generator = torch.Generator().manual_seed(0)
    quaternions = torch.nn.functional.normalize(torch.randn(6, 52, 4, generator=generator).double(), dim=-1)
    return quaternions, torch.randn(6, 3, generator=generator).double()


def features_of(quaternions, root):
    return torch.from_numpy(to_features(HUMANOID, matrix_from_quaternion(quaternions).numpy(), root.numpy()))


def test_mirrored_pose_is_the_mirror_image_of_the_pose():
    quaternions, root = random_clip()
    plain = forward_kinematics(HUMANOID, matrix_from_quaternion(quaternions), root).positions
    mirrored = matrix_from_quaternion(mirror_quaternions(HUMANOID, quaternions))
    other = forward_kinematics(HUMANOID, mirrored, mirror_positions(root)).positions
    torch.testing.assert_close(other, mirror_positions(plain)[:, list(HUMANOID.config.mirror)])


def test_twice_is_nothing():
    quaternions, root = random_clip()
    assert torch.equal(mirror_quaternions(HUMANOID, mirror_quaternions(HUMANOID, quaternions)), quaternions)
    features = features_of(quaternions, root)
    assert torch.equal(mirror_features(HUMANOID, mirror_features(HUMANOID, features)), features)


def test_both_forms_agree():
    quaternions, root = random_clip()
    torch.testing.assert_close(
        mirror_features(HUMANOID, features_of(quaternions, root)),
        features_of(mirror_quaternions(HUMANOID, quaternions), mirror_positions(root)),
    )


def test_our_rig_mirrors_and_a_lopsided_one_is_told():
    assert is_symmetric(HUMANOID)
    offsets = list(HUMANOID.config.offsets)
    offsets[HUMANOID.index("leftHand")] = (0.3, 0.0, 0.0)
    assert not is_symmetric(Skeleton(HUMANOID.config.model_copy(update={"offsets": tuple(offsets)})))


def test_a_rig_without_pairs_is_refused():
    with pytest.raises(ValueError, match="mirror pairs"):
        mirror_quaternions(Skeleton(HUMANOID.config.model_copy(update={"mirror": ()})), torch.ones(52, 4))
