from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar.corpora.rehearsal.recorded_motion import blend_recordings, load_library
from echoavatar.corpora.rehearsal.sound import SoundTrack, Span, Syllable
from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion, write_bvh
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_quaternion, quaternion_from_axis_angle

ARM = HUMANOID.index("leftUpperArm")


def motion(frames: int, angle: np.ndarray) -> Motion:
    """A standing body whose left arm turns about Z by `angle` (t,)."""
    turns = torch.zeros(frames, HUMANOID.joints, 3)
    turns[:, ARM, 2] = torch.from_numpy(angle).float()
    root = np.tile(HUMANOID.rest_positions[0].numpy(), (frames, 1))
    return Motion(HUMANOID, quaternion_from_axis_angle(turns).numpy(), root, 30.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A talk whose arm strokes every 0.8 s, a dance loop of two beats at 120 bpm, and a walk that is neither."""
    time = np.arange(600) / 30
    clips = {
        "my_talk": motion(600, -0.8 + 0.4 * np.sin(2 * np.pi * time / 0.8)),
        "my_dance": motion(30, -0.8 + 0.4 * np.sin(2 * np.pi * np.arange(30) / 30)),
        "walk": motion(60, np.zeros(60)),
    }
    for name, clip in clips.items():
        write_bvh(tmp_path / f"{name}.bvh", HUMANOID, clip.rotations, clip.root, 30)
    return tmp_path


def sound(kind: str) -> SoundTrack:
    syllables = tuple(Syllable(t, t + 0.2, t + 0.1, 0.9, "word", "") for t in np.arange(2.0, 8.0, 0.9))
    beats = np.arange(1.0, 19.0, 0.5)
    return SoundTrack(
        audio=np.zeros(20 * 24_000, np.float32),
        spans=(Span(1.0, 19.0, kind),),
        syllables=syllables if kind == "speech" else (),
        phrases=((1.5, 8.5), (10.0, 16.0)) if kind == "speech" else (),
        beats=beats if kind == "music" else np.zeros(0),
    )


def changed(before: Motion, after: Motion) -> np.ndarray:
    """(t, j): which joints changed in which frames."""
    turn = angle_between(*(matrix_from_quaternion(torch.from_numpy(m.rotations)) for m in (before, after)))
    return turn.numpy() > 1e-3


@pytest.mark.parametrize("kind", ["speech", "music"])
def test_only_the_upper_body_is_lent_and_only_within_the_sound(folder: Path, kind: str) -> None:
    library, plain = load_library(folder), motion(600, np.zeros(600))
    blended = [blend_recordings(library, sound(kind), plain, seed) for seed in range(8)]
    different = np.any([changed(plain, w) for w in blended], axis=0)
    assert different[:, ARM].any()
    assert not different[:, list(HUMANOID.config.parts["lower"])].any()
    assert not different[:25].any()
    assert all(np.array_equal(w.root, plain.root) for w in blended)


def test_blending_in_and_out_makes_no_jump(folder: Path) -> None:
    library, plain = load_library(folder), motion(600, np.zeros(600))
    for seed in range(6):
        blended = blend_recordings(library, sound("speech"), plain, seed)
        turned = matrix_from_quaternion(torch.from_numpy(blended.rotations))
        assert torch.rad2deg(angle_between(turned[:-1], turned[1:])).max() * 30 < 600


def test_the_seed_decides(folder: Path) -> None:
    library, plain = load_library(folder), motion(600, np.zeros(600))
    first, again = (blend_recordings(library, sound("speech"), plain, 1) for _ in range(2))
    assert np.array_equal(first.rotations, again.rotations)


def test_clips_of_other_names_are_left_out(folder: Path) -> None:
    library = load_library(folder)
    assert [clip.name for clip in library.speech + library.dance] == ["my_talk", "my_dance"]
    (folder / "my_talk.bvh").unlink()
    (folder / "my_dance.bvh").unlink()
    with pytest.raises(MotionError, match="no BVH whose name contains"):
        load_library(folder)


def test_frozen_hands_get_fingers_if_asked(folder: Path) -> None:
    """The talk has flat hands that never move; refined, its fingers move and the arm stays the same."""
    plain, refined = (load_library(folder, is_refined=asked).speech[0] for asked in (False, True))
    assert (plain.has_fingers, refined.has_fingers) == (False, True)
    assert np.array_equal(plain.motion.rotations[:, ARM], refined.motion.rotations[:, ARM])


def test_a_library_without_music_leaves_music_alone(folder: Path) -> None:
    library = replace(load_library(folder), dance=())
    plain = motion(600, np.zeros(600))
    assert np.array_equal(blend_recordings(library, sound("music"), plain, 0).rotations, plain.rotations)
