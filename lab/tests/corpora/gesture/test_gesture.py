import numpy as np
import pytest

from echoavatar_lab.corpora.controls import Controls
from echoavatar_lab.corpora.gesture.gesture import gesture
from echoavatar_lab.corpora.gesture.idle import resting_hands
from echoavatar_lab.corpora.gesture.speakers import draw_manner
from echoavatar_lab.corpora.solver import solve
from echoavatar_lab.corpora.sound import SoundTrack

SEEDS = range(6)


@pytest.fixture(scope="module")
def speakers(talk: SoundTrack) -> list[Controls]:
    return [gesture(talk, seed) for seed in SEEDS]


def hand_speed(controls: Controls) -> np.ndarray:
    return np.linalg.norm(np.diff(controls.wrist, axis=0), axis=-1) * 30


def test_hands_are_at_rest_a_second_after_speech(talk: SoundTrack, speakers: list[Controls]):
    late = round((talk.phrases[-1][1] + 1.6) * 30)
    for seed, controls in zip(SEEDS, speakers, strict=True):
        rest = resting_hands(draw_manner(seed).rest)[:, :3]
        assert np.linalg.norm(controls.wrist[late:] - rest, axis=-1).max() < 0.03


def test_silence_is_far_quieter_than_speech(talk: SoundTrack, speakers: list[Controls]):
    first, last = (round(t * 30) for t in talk.phrases[-1])
    speech = np.mean([hand_speed(c)[first:last].mean() for c in speakers])
    silence = np.mean([hand_speed(c)[last + 30 :].mean() for c in speakers])
    assert speech > 0.2
    assert silence < 0.15 * speech


def test_hands_strike_with_a_stress_and_turn_where_the_stroke_ends(talk: SoundTrack):
    """Mean over many speakers: slow before the vowel, fastest with it, slow where the stroke ends."""
    speed = np.mean([hand_speed(gesture(talk, seed)).max(axis=1) for seed in range(30)], axis=0)
    vowel = talk.syllables[7].vowel  # "sang", the last word: nothing follows at once

    def at(first: float, last: float) -> float:
        return float(speed[round((vowel + first) * 30) : round((vowel + last) * 30) + 1].mean())

    stroke, turn = at(0.0, 0.10), at(0.16, 0.20)
    assert stroke > 1.4 * at(-0.25, -0.07)
    assert stroke > 1.4 * turn


def test_joint_speed_and_hand_acceleration_are_limited(speakers: list[Controls]):
    for controls in speakers:
        quaternions, _ = solve(controls)
        cosine = np.abs((quaternions[1:] * quaternions[:-1]).sum(-1)).clip(0, 1)
        assert np.rad2deg(2 * np.arccos(cosine)).max() * 30 < 1000
        assert np.abs(np.diff(controls.wrist, 2, axis=0)).max() * 900 < 70


def test_planted_feet_do_not_move(speakers: list[Controls]):
    for controls in speakers:
        low = controls.foot_position[..., 1] <= 0.0851
        on_floor = low[:-1] & low[1:]
        slide = np.linalg.norm(np.diff(controls.foot_position[..., [0, 2]], axis=0), axis=-1)
        assert slide[on_floor].max() < 2e-4
