from dataclasses import replace

import numpy as np
import pytest
from lab.tests.corpora.capture.people import library

from echoavatar.models.generator.manner import Manner, draw_manner
from echoavatar_lab.corpora.capture.library import CapturedClip, CapturedLibrary
from echoavatar_lab.corpora.capture.units import ACCENT
from echoavatar_lab.corpora.controls import Controls, minimum_jerk, neutral
from echoavatar_lab.corpora.gesture.gesture import (
    LEFT,
    PATIENCE_S,
    REST_AFTER,
    RIGHT,
    gesture,
    with_clock_of,
    with_following_torso,
    with_steady_head,
)
from echoavatar_lab.corpora.gesture.idle import resting_hands
from echoavatar_lab.corpora.gesture.speakers import resting_of
from echoavatar_lab.corpora.solver import solve
from echoavatar_lab.corpora.sound import SoundTrack

SEEDS = range(6)


@pytest.fixture(scope="module")
def speakers(talk: SoundTrack) -> list[Controls]:
    return [gesture(talk, seed) for seed in SEEDS]


def hand_speed(controls: Controls) -> np.ndarray:
    return np.linalg.norm(np.diff(controls.wrist, axis=0), axis=-1) * 30


def test_hands_come_to_rest_after_speech_when_their_patience_ends(talk: SoundTrack, speakers: list[Controls]):
    late = round((talk.phrases[-1][1] + REST_AFTER + PATIENCE_S + 0.7) * 30)
    for seed, controls in zip(SEEDS, speakers, strict=True):
        rest = resting_hands(resting_of(draw_manner(seed)))[:, :3]
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


def moved_hands(talk: SoundTrack, **dials: float) -> np.ndarray:
    """Velocities of both hands over many seeds, (t, 2, 3) in mirrored axes."""
    manner = Manner(**dials)
    return np.concatenate([np.diff(gesture(talk, seed, None, manner).wrist, axis=0) for seed in range(12)])


def together(hands: np.ndarray) -> float:
    return float((hands[:, LEFT] * hands[:, RIGHT]).sum() / np.sqrt((hands**2).sum((0, 2)).prod()))


def test_two_hands_are_mirror_images_only_if_the_manner_says_so(talk: SoundTrack):
    alike, apart = (together(moved_hands(talk, both=1.0, mirror=mirror)) for mirror in (1.0, 0.0))
    assert alike > apart + 0.15


def test_the_leading_hand_and_liveliness_are_the_manners(talk: SoundTrack):
    right = np.linalg.norm(moved_hands(talk, both=0.0, right=1.0), axis=-1).sum(0)
    assert right[RIGHT] > 2 * right[LEFT]
    sizes = [np.abs(moved_hands(talk, liveliness=value)).mean() for value in (0.0, 0.5, 1.0)]
    assert 2 * sizes[0] < sizes[1] < sizes[2]


def test_captured_gestures_are_made_at_stresses(talk: SoundTrack, monkeypatch: pytest.MonkeyPatch):
    """A raised arm that no rule would raise as high; each begins with the vowel of a prominent syllable."""
    monkeypatch.setattr("echoavatar_lab.corpora.gesture.gesture.UNITS", 1.0)
    raised = neutral(18)
    raised.wrist[:, RIGHT] += minimum_jerk(np.arange(18) / 12)[:, None] * np.array([0.1, 0.85, 0.1], np.float32)
    people = library()
    units = CapturedLibrary((*people.clips, CapturedClip("a.0", "unit", ACCENT, "a/a.bvh", "MIT", raised)))
    manner = Manner(liveliness=0.7, both=0.0)
    highest = [
        np.array([gesture(talk, seed, made, manner).wrist[..., 1].max() for seed in range(6)])
        for made in (people, units)
    ]
    assert highest[0].max() < 0.15
    assert np.median(highest[1]) > 0.25
    made = gesture(talk, 1, units, manner).wrist[..., 1].max(1)
    first = int(np.argmax(made > 0.2)) / 30
    assert min(abs(first - s.vowel - 0.3) for s in talk.syllables if s.prominence > 0.3) < 0.25


def test_a_body_hurries_while_hands_move_and_its_clock_is_right_over_seconds():
    body, hands = neutral(900), np.zeros((900, 2, 3), np.float32)
    clock = np.arange(900) / 30
    body = replace(body, pelvis_position=body.pelvis_position + clock[:, None].astype(np.float32))
    busy = (clock > 14) & (clock < 16)
    hands[:, LEFT, 1] = 0.1 * np.sin(2 * np.pi * 1.5 * clock) * busy
    rate = np.diff(with_clock_of(body, hands).pelvis_position[:, 0]) * 30
    assert rate.min() > 0
    assert rate[430:470].mean() > 1.3
    assert rate[300:400].mean() < 1
    np.testing.assert_allclose(rate[100:800].mean(), 1, atol=0.02)


def test_the_shoulder_of_a_raised_hand_rises_and_the_chest_turns_away_from_a_reaching_one():
    rest = neutral(60).hands()
    up, ahead = neutral(60), neutral(60)
    up.wrist[:, LEFT, 1] += 0.4
    ahead.wrist[:, LEFT, 2] += 0.3
    assert with_following_torso(up, rest, Manner()).spine[-1, 2] > 0.01  # leans to the right
    assert with_following_torso(ahead, rest, Manner()).spine[-1, 0] < -0.05  # turns to the right
    assert with_following_torso(up, rest, Manner(tilt=0.0)).spine[-1, 2] == 0


def test_the_head_stays_with_the_listener():
    before = neutral(90)
    turned = replace(before, spine=before.spine + np.array([0.3, 0.2, 0.0], np.float32))
    steady = with_steady_head(turned, before)
    gaze = (steady.spine + steady.head - before.spine - before.head)[45]
    assert 0 < gaze[0] < 0.1
    assert 0 < gaze[1] < 0.1
