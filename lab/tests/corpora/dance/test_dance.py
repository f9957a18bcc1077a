from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.corpora.controls import neutral
from echoavatar_lab.corpora.dance.dance import ANSWER_S, dance
from echoavatar_lab.corpora.solver import solve
from echoavatar_lab.corpora.sound import SoundTrack, Span

from .test_grooves import music

CASES = [
    (124.0, 4, "house"),
    (90.0, 4, "hip_hop"),
    (172.0, 4, "drum_and_bass"),
    (150.0, 3, "waltz"),
    (58.0, 4, "ballet"),
]


def positions(quaternions: NDArray[np.float32], root: NDArray[np.float32]) -> NDArray[np.float64]:
    return Motion(HUMANOID, quaternions, root, 30.0).pose(np.float64).positions


def alignment(places: NDArray[np.float64], beats: NDArray[np.float64]) -> float:
    """How close a minimum of the joint speeds is to each beat, 0..1."""
    speed = np.linalg.norm(np.diff(places, axis=0), axis=-1).mean(1)
    lows = np.nonzero((speed[1:-1] < speed[:-2]) & (speed[1:-1] <= speed[2:]))[0] + 1.5
    return float(np.mean([np.exp(-np.square(lows / 30 - beat).min() / (2 * 0.08**2)) for beat in beats]))


@pytest.mark.parametrize(("bpm", "metre", "style"), CASES)
def test_dance_hits_beats_and_obeys_the_body(bpm: float, metre: int, style: str) -> None:
    track = music(bpm, metre=metre, style=style, seconds=24)
    controls = dance(track, 5)
    quaternions, root = solve(controls)
    places = positions(quaternions, root)
    cosine = np.abs((quaternions[1:] * quaternions[:-1]).sum(-1)).clip(0, 1)
    assert np.degrees(2 * np.arccos(cosine)).max() * 30 < 800
    assert np.abs(root[:, [0, 2]]).max() < 0.8
    assert np.abs(controls.pelvis_rotation[:, 0]).max() < np.pi / 2
    beats = track.beats[(track.beats > 4) & (track.beats < 23)]
    chance = np.random.default_rng(0).uniform(4, 23, 400)
    assert alignment(places, beats + ANSWER_S) > alignment(places, chance) + 0.1


def test_feet_on_the_floor_do_not_slide() -> None:
    track = music(120, style="house", seconds=24)
    controls = dance(track, 2)
    places = positions(*solve(controls))
    for side, name in enumerate(("leftToes", "rightToes")):
        ball = places[:, HUMANOID.index(name)]
        flat = (controls.foot_pitch[:, side] >= 0) & (ball[:, 1] < 0.0205)
        both = flat[1:] & flat[:-1]
        still = np.abs(np.diff(controls.foot_position[:, side], axis=0)).max(1) == 0
        assert (both & still).mean() > 0.4
        assert np.linalg.norm(np.diff(ball, axis=0), axis=1)[both & still].max() < 1e-4
        assert ball[:, 1].min() > 0.0199


def test_energy_makes_the_dance_bigger() -> None:
    track = music(110, style="pop", seconds=30)
    sizes = []
    for energy in (0.1, 0.95):
        sections = tuple(replace(section, energy=energy) for section in track.sections)
        tracks = [dance(replace(track, sections=sections), seed) for seed in range(3)]
        sizes.append(np.mean([np.abs(np.diff(c.foot_position, axis=0)).sum() for c in tracks]))
    assert sizes[1] > 1.5 * sizes[0]


def test_outside_music_the_dancer_stands() -> None:
    silent = SoundTrack(np.zeros(24_000 * 3, np.float32), spans=(Span(0.0, 3.0, "silence"),))
    np.testing.assert_allclose(dance(silent, 0).packed(), neutral(90).packed(), atol=1e-6)
    track = music(120, seconds=12)
    controls = dance(track, 0)
    np.testing.assert_allclose(controls[-3:].packed(), neutral(3).packed(), atol=0.02)
    assert np.ptp(controls.foot_position, axis=0).max() > 0.04


def test_music_without_beats_is_swayed_to() -> None:
    track = SoundTrack(np.zeros(24_000 * 14, np.float32), spans=(Span(1.0, 13.0, "music"),))
    controls = dance(track, 0)
    assert 0.02 < np.ptp(controls.pelvis_position[:, 0]) < 0.4
    assert np.abs(np.diff(controls.wrist, axis=0)).max() * 30 < 1.2
