import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.motion.kinematics import Motion
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_lab.evaluation import rests
from echoavatar_lab.evaluation.rests import Rests
from echoavatar_lab.evaluation.takes import Sound, Take

LOUD = np.sin(np.arange(20 * SAMPLE_RATE_HZ) / 10).astype(np.float32)


def halting(frames: int, start: int, stop: int) -> Motion:
    """Sways, but for some frames in which it stands."""
    moves = swaying(frames, size=1.5)
    at = np.arange(frames)
    at[start:stop] = start
    return Motion(moves.skeleton, moves.rotations[at], moves.root[at], moves.fps)


def take(motion: Motion, kind: str = "music", audio: np.ndarray = LOUD) -> Take:
    return Take("piece", kind, "", motion, audio)


def test_the_longest_rest_of_a_dance_is_found() -> None:
    moving, halted = (rests.rests_of(take(halting(600, 200, stop)), 20)[0] for stop in (200, 350))
    assert moving.longest_s < 1
    assert halted.longest_s == pytest.approx(5, abs=0.3)
    assert halted.share - moving.share > 0.2


def test_a_quiet_passage_is_left_out() -> None:
    sound = LOUD.copy()
    sound[int(6.5 * SAMPLE_RATE_HZ) : 12 * SAMPLE_RATE_HZ] *= 0.01
    found = rests.rests_of(take(halting(600, 200, 350), audio=sound), 20)[0]
    assert found.longest_s < 1
    assert found.quiet == pytest.approx(4.5 / 20, abs=0.02)
    assert not rests.is_quiet(LOUD, 600).any()


def test_talk_is_cut_into_shorter_windows() -> None:
    found = rests.rests_of(take(halting(600, 0, 0), kind="speech"), 20)
    assert len(found) == 2


def test_bundled_pieces_take_turns_with_recorded_ones() -> None:
    sounds = [Sound(f"{kind} {n}", kind, "", LOUD) for kind in ("speech", "music") for n in range(3)]
    found = rests.with_bundled(sounds, 12, 5)
    assert [one.name for one in found] == ["music 0", "music", "music 1", "Bright_House", "music 2"]
    assert len(found[1].audio) == 12 * SAMPLE_RATE_HZ
    assert len(rests.with_bundled([], 12, 9)) == 5


def test_the_table_counts_who_keeps_the_limits() -> None:
    made = [Rests("a", "music", 1.0, 0.1, 0.0, 0.0), Rests("b", "music", 16.0, 0.6, 0.5, 0.0)]
    text = rests.as_text(made, [Rests("c", "music", 1.6, 0.1, 0.0, 0.0)])
    ours, people, worst = text.splitlines()[1:4]
    assert ours.split()[2:] == ["2", "16.00", "16.00", "8.50", "1", "0.60", "0.60", "0.35", "1", "0.250", "0.000"]
    assert people.split()[:5] == ["music,", "people", "1", "1.60", "1.60"]
    assert worst.split()[0] == "b"
    assert rests.as_json(made) == {"music": [["a", 1.0, 0.1, 0.0, 0.0], ["b", 16.0, 0.6, 0.5, 0.0]]}


def test_arms_that_hang_are_told_from_arms_that_are_held() -> None:
    held = halting(600, 0, 600)
    held.rotations[:] = (1, 0, 0, 0)  # a T-pose
    down = held.rotations.copy()
    for side, sign in (("left", -1), ("right", 1)):
        down[:, held.skeleton.index(f"{side}UpperArm")] = (np.cos(0.7), 0, 0, sign * np.sin(0.7))
    hanging = Motion(held.skeleton, down, held.root, held.fps)
    assert [rests.rests_of(take(one), 20)[0].share for one in (held, hanging)] == [1, 1]
    assert [rests.rests_of(take(one), 20)[0].hanging for one in (held, hanging)] == [0, 1]
