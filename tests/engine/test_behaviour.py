"""How the default bundle behaves where the paper is silent: it listens, nods, settles after music, stands alive."""

import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import soundfile
from tests.motion.viewer import eyes_off_viewer, off_viewer

import echoavatar
from echoavatar.engine import Engine, Session, SessionCore
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.timing import CHUNK_FRAMES, CHUNK_SAMPLES, FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar_lab.data.faults import skate

_log = logging.getLogger(__name__)
pytestmark = pytest.mark.slow
SILENCE = np.zeros(CHUNK_SAMPLES, np.float32)


@pytest.fixture(scope="module")
def pipeline() -> Pipeline:
    return Pipeline(load_bundle("default"))


def sound(name: str) -> np.ndarray:
    samples: np.ndarray = soundfile.read(f"{echoavatar.__path__[0]}/assets/{name}.ogg", dtype="float32")[0]
    return samples


def chunks(samples: np.ndarray) -> Iterator[np.ndarray]:
    for start in range(0, len(samples) - CHUNK_SAMPLES + 1, CHUNK_SAMPLES):
        yield samples[start : start + CHUNK_SAMPLES]


def hear(session: SessionCore, sounds: Iterator[np.ndarray] | list[np.ndarray]) -> MotionChunk:
    made = []
    for piece in sounds:
        session.push(piece)
        made += list(Session(session))
    return join(made)


def positions(motion: MotionChunk) -> dict[str, np.ndarray]:
    turns = matrix_from_quaternion(motion.rotations)
    pose = forward_kinematics(HUMANOID, turns, motion.root.astype(np.float32))
    return {name: pose.positions[:, at] for at, name in enumerate(HUMANOID.names)}


def speed(motion: MotionChunk, names: tuple[str, ...] = ("leftHand", "rightHand", "hips", "head")) -> np.ndarray:
    """Mean of these points, metres per second, frame by frame."""
    place = positions(motion)
    steps = [np.linalg.norm(np.diff(place[name], axis=0), axis=1) for name in names]
    return np.asarray(np.mean(steps, axis=0) * FRAME_RATE_HZ)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_looks_at_who_speaks_and_nods_at_their_pauses(pipeline: Pipeline, seed: int) -> None:
    """The user speaks three times for three seconds with half a second between, then no more."""
    session = Engine(pipeline, rewind=0).open_core(seed=seed)
    voice = sound("speech")[round(0.6 * SAMPLE_RATE_HZ) :]
    turn = np.concatenate([voice[: 2 * SAMPLE_RATE_HZ], voice[:SAMPLE_RATE_HZ], np.zeros(SAMPLE_RATE_HZ // 2)])
    user = np.concatenate([np.zeros(8 * CHUNK_SAMPLES), *[turn] * 3, np.zeros(12 * CHUNK_SAMPLES)])
    made, nods = [], []
    for number, piece in enumerate(chunks(user.astype(np.float32))):
        session.listen(piece)
        running = session._actions.running(session._barge_in.next_chunk)
        if running is not None and running.action.name == "nod" and running.begin == session._barge_in.next_chunk:
            nods.append(number)
        made.append(hear(session, [SILENCE]))
    motion = join(made)
    off = np.degrees(off_viewer(motion))
    begin, end = 8 * CHUNK_FRAMES, 8 * CHUNK_FRAMES + round(10.5 * FRAME_RATE_HZ)
    listening = off[begin + 30 : end]
    eyes = [
        ARKIT_NAMES.index(f"eyeLook{way}{side}") for way in ("Up", "Down", "In", "Out") for side in ("Left", "Right")
    ]
    assert motion.face is not None
    turned = np.degrees(positions_of_nose(motion))
    depths = [np.ptp(turned[at * CHUNK_FRAMES : (at + 5) * CHUNK_FRAMES]) for at in nods]
    _log.info(
        "seed %d: head off the viewer %.1f deg (idle %.1f), nods %d, deep %s deg",
        seed,
        np.median(listening),
        np.median(off[:begin]),
        len(nods),
        np.round(depths, 1),
    )
    assert np.median(listening) < 10
    assert (np.degrees(eyes_off_viewer(motion))[begin + 30 : end] < 5).mean() > 0.6
    assert motion.face[:, eyes].max() <= 1
    assert len(nods) >= 1
    assert min(depths) > 4
    assert not session.is_listening
    assert session._actions.running(session._barge_in.next_chunk) is None


def test_a_speakers_eyes_meet_the_viewer_half_of_the_time(pipeline: Pipeline) -> None:
    """Within 5 degrees, over three seeds of the shipped speech; its phrases begin with a glance away."""
    speech, near, begun = sound("speech"), [], []
    for seed in (1, 2, 3):
        motion = hear(Engine(pipeline, rewind=0).open_core(seed=seed), chunks(speech))
        off = np.degrees(eyes_off_viewer(motion))
        power = np.mean(np.square(speech[: len(off) * 800]).reshape(len(off), -1), 1)
        loud = power > power.max() / 300
        near.append((off[[loud[max(0, at - 17) : at + 1].any() for at in range(len(off))]] < 5).mean())
        begun += [
            (off[at : at + 10] > 5).any() for at in range(8, len(off)) if loud[at] and not loud[at - 8 : at].any()
        ]
    _log.info("eyes on the viewer while speaking: %s; starts with a glance %.2f", np.round(near, 2), np.mean(begun))
    assert 0.38 < np.mean(near) < 0.62
    assert np.mean(begun) > 0.6


def positions_of_nose(motion: MotionChunk) -> np.ndarray:
    """How far the head points down, radians."""
    turns = matrix_from_quaternion(motion.rotations)
    pose = forward_kinematics(HUMANOID, turns, motion.root.astype(np.float32))
    ahead = pose.rotations[:, HUMANOID.index("head"), :, 2]
    return np.asarray(-np.arcsin(np.clip(ahead[:, 1], -1, 1)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_settles_within_a_second_when_music_breaks_off(pipeline: Pipeline, seed: int) -> None:
    """Nine seconds of music, cut in the middle of a bar; digital silence after it."""
    session = Engine(pipeline, rewind=0).open_core(seed=seed)
    music = sound("music")[4 * SAMPLE_RATE_HZ :]
    dance = hear(session, list(chunks(music))[:34])
    after = hear(session, [SILENCE] * 9)  # then it goes home
    moving = speed(dance)[-150:].mean()
    rest = speed(after)
    quarter = np.array([rest[at : at + 8].mean() for at in range(len(rest) - 8)])
    settled = np.flatnonzero(quarter > 0.3 * moving)
    seconds = (settled.max() + 1 if len(settled) else 0) / FRAME_RATE_HZ
    _log.info(
        "seed %d: %.2f m/s in the dance, %.3f from the second second on; settled after %.2f s",
        seed,
        moving,
        rest[30:].mean(),
        seconds,
    )
    assert moving > 0.15
    assert rest[30:].mean() < 0.25 * moving
    assert seconds < 1.2
    assert rest[60:].max() > 0.002, "alive, not frozen"


@pytest.mark.parametrize("has_home", [True, False])
def test_after_a_dance_it_steps_back_to_its_place(has_home: bool) -> None:
    """Fourteen seconds of music, sixteen of silence, two seeds; planted feet slide no more than in the dance."""
    bundle = load_bundle("default")
    runtime = bundle.runtime
    if not has_home:
        kept = tuple(part for part in runtime.session if part != "home")
        runtime = runtime.model_copy(update={"session": kept})
    engine = Engine(Pipeline(replace(bundle.without(["face"]), runtime=runtime)), seats=2, rewind=0, workers=0)
    music = sound("music")[: 14 * SAMPLE_RATE_HZ]
    for seed in (1, 4):
        session = engine.open_core(seed=seed)
        hear(session, list(chunks(music)))
        after = hear(session, [SILENCE] * 60)
        far = np.hypot(*after.root[[0, -1]][:, [0, 2]].T)
        place = positions(after)
        balls = np.stack([place[toes] for toes in ("leftToes", "rightToes")], 1)
        standing = HUMANOID.rest_positions[[HUMANOID.index(toes) for toes in ("leftToes", "rightToes")], 1]
        slides = skate(balls[60:], FRAME_RATE_HZ, standing_height=standing)
        _log.info("seed %d: %.2f m away, then %.2f; feet slide %.2f cm/s", seed, *far, slides)
        assert far[0] > 0.9
        assert (far[1] < 0.08) == has_home
        assert slides < 0.2


def test_speech_that_comes_at_once_finds_it_standing() -> None:
    """Three seconds of speech, twelve seeds: where the hands are in the first frame, begun stood and begun cold."""
    bundle, highest = load_bundle("default"), {}
    for lead_in_s in (0.0, 2.0):
        runtime = bundle.runtime.model_copy(update={"lead_in_s": lead_in_s})
        engine = Engine(Pipeline(replace(bundle.without(["face"]), runtime=runtime)), seats=12, rewind=0, workers=0)
        sessions = [engine.open_core(seed=seed) for seed in range(12)]
        for session in sessions:
            session.push(sound("speech")[round(0.6 * SAMPLE_RATE_HZ) :][: 3 * SAMPLE_RATE_HZ])
        while engine.tick():
            pass
        made = [join(list(Session(session))) for session in sessions]
        begun = [positions(motion) for motion in made]
        highest[lead_in_s] = [max(place["leftHand"][0, 1], place["rightHand"][0, 1]) for place in begun]
        feet = np.mean([speed(motion, ("leftFoot", "rightFoot")).mean() for motion in made])
        _log.info("from %s s: hands at %s m, feet %.3f m/s", lead_in_s, np.round(highest[lead_in_s], 2), feet)
        assert feet < 0.15  # people who speak: 0.08
        assert max(np.abs(motion.root[0, [0, 2]]).max() for motion in made) < 0.02  # over its feet
    assert max(highest[2.0]) < 1.0 < max(highest[0.0])


def test_it_dances_to_music_and_not_to_speech(pipeline: Pipeline) -> None:
    legs = ("hips", "leftLowerLeg", "rightLowerLeg", "leftFoot", "rightFoot")
    found = {}
    for name in ("speech", "music"):
        session = Engine(pipeline, rewind=0).open_core(seed=1)
        found[name] = speed(hear(session, list(chunks(sound(name)))[4:40]), legs).mean()
    _log.info("hips and legs: %.3f m/s in speech, %.3f in music", found["speech"], found["music"])
    assert found["music"] > 2 * found["speech"]


def test_nobody_freezes_in_silence(pipeline: Pipeline) -> None:
    session = Engine(pipeline, rewind=0).open_core(seed=1)
    motion = hear(session, [SILENCE] * 75)
    place = positions(motion)
    late = slice(5 * FRAME_RATE_HZ, None)
    assert np.ptp(place["hips"][late, 0]) > 0.008
    assert np.ptp(np.degrees(off_viewer(motion))[late]) > 2
    assert speed(motion)[150:].max() < 0.55  # a hand that changes its place, no lurch
    feet = np.stack([place[foot][late] for foot in ("leftFoot", "rightFoot")], 1)
    away = np.linalg.norm(feet - feet[:1], axis=2).max()
    balls = np.stack([place[toes][late] for toes in ("leftToes", "rightToes")], 1)
    standing = HUMANOID.rest_positions[[HUMANOID.index("leftToes"), HUMANOID.index("rightToes")], 1]
    slides = skate(balls, FRAME_RATE_HZ, standing_height=standing)
    _log.info("silence: hips %.3f m, feet %.3f m away, %.2f cm/s", np.ptp(place["hips"][late, 0]), away, slides)
    assert away < 0.3  # a step
    assert slides < 0.5
