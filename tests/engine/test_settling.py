"""When a dance must end, and when not: silence that begins, legs that dance, and the same decision a second time."""

import numpy as np
import pytest
from tests.engine.fakes import FakePipeline, Heard

from echoavatar.engine import Engine, Session
from echoavatar.engine.settling import Settling, arm_speed, joint_speed
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import CHUNK_SAMPLES, ChunkSize

LOUD, QUIET = np.full(CHUNK_SAMPLES, 0.1, np.float32), np.zeros(CHUNK_SAMPLES, np.float32)
MUSIC, HUM = 0.1 * LOUD, 0.01 * LOUD  # soft music, and the noise of a room
DANCING, STEPPING, STANDING = 60.0, 36.0, 8.0  # degrees per second
LEGS = [f"{side}{part}" for side in ("left", "right") for part in ("UpperLeg", "LowerLeg")]
ARMS = [name.replace("Leg", "Arm") for name in LEGS]


def limbs(legs: float, arms: float = 60.0) -> MotionChunk:
    """Hips and knees turn at a speed, shoulders and elbows at another, degrees per second."""
    rotations = np.zeros((8, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    for names, speed in ((LEGS, legs), (ARMS, arms)):
        half = np.radians(speed) * np.arange(8) / 30 / 2
        for name in names:
            joint = HUMANOID.index(name)
            rotations[:, joint, 0], rotations[:, joint, 1] = np.cos(half), np.sin(half)
    return MotionChunk(rotations, np.zeros((8, 3), np.float32))


def told(sounds: list[np.ndarray], speed: float) -> list[bool]:
    settling, answers = Settling(), []
    for chunk, sound in enumerate(sounds):
        answers.append(settling.must_forget(chunk, sound))
        settling.made(chunk, sound, limbs(speed), HUMANOID)
    return answers


@pytest.mark.parametrize("speed", [0, 5, 40, 300])
def test_speed_of_legs_is_in_degrees_per_second(speed: float) -> None:
    assert joint_speed(limbs(speed), HUMANOID, LEGS) == pytest.approx(speed, rel=1e-2)


DANCE = [LOUD] * 16


def test_a_dance_is_broken_off_by_the_first_silent_chunk_and_again_while_it_goes_on() -> None:
    answers = told([*DANCE, *[QUIET] * 5, *DANCE, QUIET], DANCING)
    assert [chunk for chunk, forgets in enumerate(answers) if forgets] == [16, 19, 37]


@pytest.mark.parametrize(("frames", "quiet", "counted"), [(8, 1, 1), (4, 1, 0), (4, 2, 1), (4, 4, 3), (12, 1, 1)])
def test_silence_is_as_long_whatever_the_chunk(frames: int, quiet: int, counted: int) -> None:
    """A quarter of a second, which sounds in music are apart: two chunks of four frames."""
    settling, heard = Settling(ChunkSize(frames // 4)), [LOUD] * 3 + [QUIET] * quiet
    for chunk, sound in enumerate(heard[:-1]):
        settling.made(chunk, sound, limbs(DANCING), HUMANOID)
    assert settling.silence(len(heard) - 1, heard[-1]) == counted


def test_soft_music_is_danced_to_and_the_noise_of_a_room_is_silence() -> None:
    """-40 and -60 dBFS."""
    assert not any(told([*DANCE, *[MUSIC] * 5], DANCING))
    assert told([*DANCE, HUM], DANCING)[-1]


def test_a_dance_that_stands_still_between_moves_is_a_dance() -> None:
    settling = Settling()
    for chunk, speed in enumerate([80] * 12 + [2] * 3):
        settling.made(chunk, LOUD, limbs(speed), HUMANOID)
    assert settling.must_forget(15, QUIET)
    settling.made(15, LOUD, limbs(2), HUMANOID)
    assert not settling.must_forget(16, LOUD)


def test_a_body_that_has_come_to_rest_is_left_alone() -> None:
    settling = Settling()
    for chunk, sound in enumerate([*DANCE, *[QUIET] * 3]):
        settling.made(chunk, sound, limbs(DANCING if sound is LOUD else STANDING), HUMANOID)
    assert not settling.must_forget(19, QUIET)


@pytest.mark.parametrize("speed", [STANDING, 30, STEPPING])
def test_who_talks_stands_or_steps_is_left_alone(speed: float) -> None:
    assert not any(told([*DANCE, QUIET, QUIET, LOUD, QUIET], speed))


def test_sound_that_goes_on_breaks_nothing_off() -> None:
    assert not any(told(DANCE, DANCING))


def test_a_chunk_that_is_made_again_is_judged_again() -> None:
    settling = Settling()
    for chunk, sound in enumerate((*DANCE, QUIET, QUIET)):
        settling.made(chunk, sound, limbs(DANCING), HUMANOID)
    assert settling.must_forget(16, QUIET)
    assert not settling.must_forget(16, LOUD)
    assert not settling.must_forget(17, QUIET)


class Dancer(FakePipeline):
    """Dances whatever it hears, until it is made to forget."""

    def __init__(self) -> None:
        self.forgot = 0

    def restart_generator(self, state: Heard, rows: np.ndarray) -> None:
        self.forgot += int(rows.sum())

    def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> list[MotionChunk]:
        return [limbs(0 if self.forgot else 200) for _ in audio]


def test_the_engine_makes_the_model_forget() -> None:
    dancer = Dancer()
    session = Engine(dancer).open_core()  # type: ignore[arg-type]
    session.push(np.concatenate(DANCE))
    assert all(joint_speed(chunk, HUMANOID, LEGS) > DANCING for chunk in Session(session))
    session.push(np.concatenate([QUIET, QUIET]))
    assert all(joint_speed(chunk, HUMANOID, LEGS) < 1 for chunk in Session(session))
    assert dancer.forgot == 1


def dancing(sounds: list[np.ndarray], speed: float) -> list[bool]:
    settling, answers = Settling(), []
    for chunk, sound in enumerate(sounds):
        settling.made(chunk, sound, limbs(speed), HUMANOID)
        answers.append(settling.is_dancing(chunk))
    return answers


def test_who_dances_is_told_within_four_seconds_and_until_the_sound_has_gone() -> None:
    answers = dancing([LOUD] * 18 + [QUIET] * 6, DANCING)
    assert not any(answers[:8])
    assert all(answers[12:19])
    assert not any(answers[21:])


def test_who_steps_while_talking_does_not_dance() -> None:
    assert not any(dancing([LOUD] * 24, STEPPING))


def freed(sounds: list[np.ndarray], speed: float, arms: float, *, acts: bool = False) -> list[int]:
    """The chunks before which the model must forget."""
    settling, answers = Settling(), []
    for chunk, sound in enumerate(sounds):
        if settling.must_forget(chunk, sound, acts=acts):
            answers.append(chunk)
        settling.made(chunk, sound, limbs(speed, arms), HUMANOID)
    return answers


RESTING = 4.0  # degrees per second


def test_a_dance_in_which_the_arms_rest_for_half_a_second_is_freed_and_again_while_they_rest() -> None:
    assert freed([LOUD] * 30, DANCING, RESTING)[-4:] == [22, 24, 26, 28]


def test_who_stands_in_sound_is_freed_after_two_seconds() -> None:
    assert freed([LOUD] * 20, STANDING, RESTING) == [8, 16]


@pytest.mark.parametrize(("size", "rests"), [(1.0, True), (0.5, False)])
def test_small_gestures_are_no_rest(size: float, rests: bool) -> None:
    settling = Settling()
    for chunk in range(8):
        settling.made(chunk, LOUD, limbs(STANDING, 20.0), HUMANOID, size=size)
    assert settling.must_forget(8, LOUD) == rests


def test_a_dance_of_one_who_gestures_little_is_freed_too() -> None:
    """Nothing makes the moves of a dance smaller."""
    settling = Settling()
    for chunk in range(60):
        settling.made(chunk, LOUD, limbs(DANCING) if chunk < 20 else limbs(STANDING, RESTING), HUMANOID, size=0.0)
    assert settling.must_forget(60, LOUD)


def test_arms_at_rest_are_asked_to_work_after_half_a_second_of_sound() -> None:
    for sound in (LOUD, QUIET):
        settling, asked = Settling(), []
        for chunk in range(4):
            asked.append(settling.rests(chunk))
            settling.made(chunk, sound, limbs(STANDING, RESTING), HUMANOID)
        assert asked == [False, False, sound is LOUD, sound is LOUD]


def test_arms_that_move_or_act_or_rest_in_silence_or_in_short_sentences_are_left_alone() -> None:
    assert not freed([LOUD] * 30, DANCING, 40.0)
    assert not freed([LOUD] * 30, STANDING, RESTING, acts=True)
    assert not freed([QUIET] * 30, STANDING, RESTING)
    assert not freed([*[LOUD] * 5, *[QUIET] * 4] * 3, STANDING, RESTING)


def test_a_breath_between_phrases_is_no_new_start() -> None:
    assert freed([*[LOUD] * 5, QUIET] * 3, STANDING, RESTING) == [9]


def test_a_dance_that_came_to_rest_is_one_until_the_music_has_ended() -> None:
    settling = Settling()
    for chunk in range(60):
        settling.made(chunk, LOUD, limbs(DANCING) if chunk < 20 else limbs(STANDING, RESTING), HUMANOID)
    assert settling.must_forget(60, LOUD)  # 40 chunks of rest, a multiple of two
    settling.made(60, LOUD, limbs(STANDING, 60), HUMANOID)
    for chunk in range(61, 65):
        settling.made(chunk, LOUD, limbs(STANDING, RESTING), HUMANOID)
    assert settling.must_forget(65, LOUD)
    for chunk in range(65, 69):
        settling.made(chunk, QUIET, limbs(STANDING, RESTING), HUMANOID)
    for chunk in range(69, 71):
        settling.made(chunk, LOUD, limbs(STANDING, RESTING), HUMANOID)
    assert not settling.must_forget(71, LOUD)


def test_a_shoulder_that_takes_over_some_of_its_arms_rotation_leaves_it_as_fast() -> None:
    alone, shared = limbs(STANDING, 30.0), limbs(STANDING, 30.0)
    for side in ("left", "right"):
        arm, shoulder = HUMANOID.index(f"{side}UpperArm"), HUMANOID.index(f"{side}Shoulder")
        for joint, share in ((shoulder, 0.3), (arm, 0.7)):
            half = share * np.arctan2(alone.rotations[:, arm, 1], alone.rotations[:, arm, 0])
            shared.rotations[:, joint, 0], shared.rotations[:, joint, 1] = np.cos(half), np.sin(half)
    assert joint_speed(shared, HUMANOID, ARMS) == pytest.approx(25.5, abs=0.1)
    assert arm_speed(shared, HUMANOID) == pytest.approx(arm_speed(alone, HUMANOID)) == pytest.approx(30, abs=0.1)
