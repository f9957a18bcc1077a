import logging
from pathlib import Path

import numpy as np
import pytest

import echoavatar
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.models.audio import read_audio
from echoavatar.motion.kinematics import Motion
from echoavatar.timing import CHUNK_FRAMES
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS, clip
from echoavatar_lab.evaluation.actions import BEGIN_CHUNKS, _score_action, evaluate_actions, head_turn, joints_and_nose

_log = logging.getLogger(__name__)


def then(first: Motion, second: Motion) -> Motion:
    rotations, root = (np.concatenate([getattr(m, part) for m in (first, second)]) for part in ("rotations", "root"))
    return Motion(first.skeleton, rotations, root, first.fps)


def still(motion: Motion, frames: int) -> Motion:
    return Motion(
        motion.skeleton, motion.rotations[:1].repeat(frames, 0), motion.root[:1].repeat(frames, 0), motion.fps
    )


def test_acting_comes_near_the_clip_and_standing_does_not() -> None:
    wanted = clip(SCRIPTS["raise_left_hand"])
    before = still(wanted, BEGIN_CHUNKS * CHUNK_FRAMES)
    on, off = then(then(before, wanted), still(wanted, 40)), still(wanted, 200)
    acted = _score_action("raise_left_hand", off, on)
    assert acted.on_cm < 0.1
    assert acted.off_cm > 50
    assert "leftHand" in acted.points
    assert "rightHand" not in acted.points


def test_points_do_not_depend_on_where_the_body_stands_and_faces() -> None:
    motion = clip(SCRIPTS["wave"])
    turned = Motion(motion.skeleton, motion.rotations.copy(), motion.root + 3, motion.fps)
    half = np.array([np.cos(0.6), 0, np.sin(0.6), 0])
    w, x, y, z = turned.rotations[:, 0].T
    a, _, c, _ = half
    turned.rotations[:, 0] = np.stack([a * w - c * y, a * x + c * z, a * y + c * w, a * z - c * x], -1)
    np.testing.assert_allclose(joints_and_nose(turned), joints_and_nose(motion), atol=1e-5)


def test_looking_around_turns_the_head_as_far_as_the_clip() -> None:
    wanted = clip(SCRIPTS["look_around"])
    before = still(wanted, BEGIN_CHUNKS * CHUNK_FRAMES)
    on, off = then(then(before, wanted), still(wanted, 40)), still(wanted, 200)
    acted = _score_action("look_around", off, on)
    assert acted.is_head_action
    assert not _score_action("bow", off, off).is_head_action
    assert acted.head_off == pytest.approx((0, 0), abs=1e-3)
    assert acted.head_on.yaw == pytest.approx(acted.head_clip.yaw, abs=1)
    assert acted.head_clip.yaw > 90
    assert acted.head_on.pitch < 20


def test_a_head_turns_as_far_as_it_is_turned_wherever_the_body_faces() -> None:
    """40 degrees to the left and 25 up, on hips that face backwards (half a turn, where yaw would wrap)."""
    motion = still(clip(SCRIPTS["neutral"]), 3)
    motion.rotations[:] = [1, 0, 0, 0]
    motion.rotations[:, 0] = [0, 0, 1, 0]
    head, half = motion.skeleton.index("head"), np.radians([20, 12.5])
    motion.rotations[1, head] = [np.cos(half[0]), 0, np.sin(half[0]), 0]
    motion.rotations[2, head] = [np.cos(half[1]), -np.sin(half[1]), 0, 0]
    np.testing.assert_allclose(head_turn(motion, slice(None)), (40, 25), atol=1e-3)
    np.testing.assert_allclose(head_turn(motion, slice(2)), (40, 0), atol=1e-3)


def test_the_shipped_generator_raises_its_hands_when_told(voice: np.ndarray) -> None:
    """Whatever the seed: the mean of two seeds is that of each alone."""
    pipeline = Pipeline(load_bundle("default"))
    alone = [evaluate_actions(pipeline, voice, ["raise_both_hands"], seeds=[seed])[0] for seed in (0, 1)]
    (acted,) = evaluate_actions(pipeline, voice, ["raise_both_hands"], seeds=[0, 1])
    assert acted.on_cm == pytest.approx((alone[0].on_cm + alone[1].on_cm) / 2)
    assert acted.head_on.yaw == pytest.approx((alone[0].head_on.yaw + alone[1].head_on.yaw) / 2)
    assert acted.fastest_deg_s == max(one.fastest_deg_s for one in alone)
    assert acted.on_cm < 0.5 * acted.off_cm
    assert acted.fastest_deg_s < 1200


@pytest.mark.parametrize("name", ["neutral", "agree"])
def test_every_clip_moves_some_points(name: str) -> None:
    assert _score_action(name, still(clip(SCRIPTS[name]), 200), still(clip(SCRIPTS[name]), 200)).points


@pytest.mark.slow
def test_every_shipped_action_does_what_its_clip_shows() -> None:
    """On against off with the same speech and seed: the points that the clip moves come nearer to where it has them.

    Listening and its nod move no point by 5 cm; the nod is told by how far the head goes down.
    """
    speech = read_audio(Path(echoavatar.__path__[0]) / "assets" / "speech.ogg")
    pipeline = Pipeline(load_bundle("default"))
    acted = {one.name: one for one in evaluate_actions(pipeline, speech)}
    assert set(acted) == set(pipeline.actions) & set(SCRIPTS)
    assert len(acted) >= 55
    for name, one in acted.items():
        _log.info("%s: %.1f cm off, %.1f cm on, %.0f deg/s", name, one.off_cm, one.on_cm, one.fastest_deg_s)
    nod, _ = acted.pop("nod"), acted.pop("listen")
    assert np.ptp(joints_and_nose(nod.motion)[BEGIN_CHUNKS * CHUNK_FRAMES :][:40, -1, 1]) > 0.02
    assert [name for name, one in acted.items() if one.on_cm >= one.off_cm] == []
    for name, way in (("look_around", "yaw"), ("disagree", "yaw"), ("agree", "pitch")):
        off, on, own = (
            getattr(head, way) for head in (acted[name].head_off, acted[name].head_on, acted[name].head_clip)
        )
        _log.info("%s: head %s %.0f degrees off, %.0f on, %.0f in the clip", name, way, off, on, own)
        assert on > 0.5 * own
        assert on > off + 0.4 * own, "the same speech without the action turns the head less"
    raised = [acted[name] for name in ("raise_left_hand", "raise_right_hand", "raise_both_hands", "wave")]
    assert max(one.on_cm / one.off_cm for one in raised) < 0.6
    assert max(one.fastest_deg_s for one in acted.values()) < 1400
