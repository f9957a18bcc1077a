from dataclasses import replace

import numpy as np
import pytest
from lab.tests.corpora.capture import people

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.corpora.capture.library import CapturedClip, CapturedLibrary
from echoavatar_lab.corpora.controls import Controls, neutral
from echoavatar_lab.corpora.dance.dance_graph import dance_graph
from echoavatar_lab.corpora.dance.grooves import GROOVES, Counts
from echoavatar_lab.corpora.dance.phrases import can_dance, captured_dance, choose
from echoavatar_lab.corpora.rehearsal.choreography import choreograph
from echoavatar_lab.corpora.solver import solve
from echoavatar_lab.corpora.sound import SoundTrack, Span
from echoavatar_lab.evaluation.metrics.beat_alignment import dance_alignment, dance_beats

GROUPS = ("salsa_lead", "salsa_follow")


def stepping_in_place(seconds: float, period: float) -> Controls:
    """Feet in turns, arms and hips with them; the body comes to rest once a period."""
    time = np.arange(round(seconds * 30)) / 30
    count = time / period
    body = neutral(len(time))
    ease = np.floor(count) + (lambda p: p**3 * (10 - 15 * p + 6 * p * p))(count % 1)
    side = np.cos(np.pi * ease)
    feet, pelvis, wrist = body.foot_position.copy(), body.pelvis_position.copy(), body.wrist.copy()
    lift = 0.12 * np.sin(np.pi * (count % 1)) ** 2
    feet[:, 0, 1] += lift * (np.floor(count) % 2 == 0)
    feet[:, 1, 1] += lift * (np.floor(count) % 2 == 1)
    feet[:, :, 0] += 0.06 * side[:, None] * (lift > 0.01)[:, None]
    pelvis[:, 0] += 0.05 * side
    wrist[:, :, 2] += 0.25 + 0.12 * side[:, None] * np.array([1, -1])
    return replace(body, foot_position=feet, pelvis_position=pelvis, wrist=wrist)


@pytest.fixture(scope="module")
def library() -> CapturedLibrary:
    dance = stepping_in_place(24.0, 0.36)
    return CapturedLibrary((CapturedClip("a", "dance", "salsa_lead", "set/a.bvh", "CC0", dance),))


def piece(beat: float, end: float) -> Counts:
    return Counts(np.arange(0.3, end, beat), 4, GROOVES["salsa"], ((0, 999, 0.5),), 0.0, end)


def test_the_body_arrives_on_the_beats_of_the_music(library: CapturedLibrary):
    first, dance = captured_dance(dance_graph(library), GROUPS, piece(0.45, 30.0), np.random.default_rng(0))
    assert first <= 0
    rotations, root = solve(dance[-first:])
    places = Motion(HUMANOID, rotations, root, 30.0).pose().positions
    found, beats = dance_beats(places), np.arange(0.3, 30.0, 0.45)
    assert dance_alignment(found, beats) > dance_alignment(found, beats + 0.2) + 0.15
    assert len(dance) + first > 900
    assert np.linalg.norm(dance.pelvis_position[:, [0, 2]], axis=1).max() < 1.0


def test_the_same_seed_is_the_same_dance_and_another_seed_another(library: CapturedLibrary):
    one, two, other = (
        captured_dance(dance_graph(library), GROUPS, piece(0.45, 20.0), np.random.default_rng(seed))[1].packed()
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(one, two)
    assert np.abs(one[: len(other)] - other[: len(one)]).max() > 0.02


def test_a_tempo_that_no_dance_fits_is_refused(library: CapturedLibrary):
    dances = dance_graph(library)
    assert can_dance(dances, GROUPS, piece(0.45, 20.0))
    assert not can_dance(dances, GROUPS, piece(6.0, 60.0))
    assert not can_dance(dances, ("nobody",), piece(0.45, 20.0))
    with pytest.raises(ValueError, match="tempo"):
        choose(dances, GROUPS, piece(6.0, 60.0), np.random.default_rng(0))


def test_a_captured_dance_starts_and_stops_without_a_jolt(library: CapturedLibrary):
    """Silence, music, silence: the body goes into the dance from where it stands, and stands where the dance ends."""
    both = CapturedLibrary((*people.library().clips, *library.clips))
    spans = (Span(0.0, 4.0, "silence"), Span(4.0, 16.0, "music"), Span(16.0, 20.0, "silence"))
    track = SoundTrack(np.zeros(20 * 24_000, np.float32), spans=spans, beats=np.arange(4.2, 16.0, 0.34))
    danced = [choreograph(track, seed, both) for seed in range(3)]
    for controls in danced:
        rotations, root = solve(controls)
        cosine = np.abs((rotations[1:] * rotations[:-1]).sum(-1)).clip(0, 1)
        assert np.degrees(2 * np.arccos(cosine)).max() * 30 < 1200
        assert np.abs(np.diff(root, axis=0)).max() * 30 < 2.5
    assert any(np.abs(np.diff(controls.foot_position[150:450, 0, 1])).max() > 0.01 for controls in danced)
