from typing import Any

import numpy as np
import pytest
from tests.motion.stages.poses import everyone

from echoavatar.motion.stages.leash import EDGE, NEAR, PULL_SPEED, Leash, LeashState
from echoavatar.motion.stages.pose import Pose


def step(
    leash: Leash,
    root: np.ndarray,
    state: LeashState,
    *,
    radius: float = 1.0,
    lean: float = 0.0,
    is_pinned: bool = False,
    active: np.ndarray | None = None,
) -> np.ndarray:
    """Root (3, t, b) in and out."""
    rows = root.shape[2]
    way = np.array(root.transpose(2, 1, 0), np.float32, order="C")
    pose = Pose(np.zeros((*way.shape[:2], 1, 4), np.float32), way, 30.0)
    leash.step(
        pose,
        state,
        everyone(rows) if active is None else active,
        radius=np.full(rows, radius, np.float32),
        is_pinned=np.full(rows, is_pinned),
        lean=np.full(rows, lean, np.float32),
    )
    return pose.root.transpose(2, 1, 0)


def steps(leash: Leash, root: np.ndarray, state: LeashState, **options: Any) -> np.ndarray:
    """A whole clip, chunk by chunk."""
    parts = [root[:, start : start + 8] for start in range(0, root.shape[1], 8)]
    return np.concatenate([step(leash, part, state, **options) for part in parts], 1)


def wander(chunks: int, rows: int = 1, seed: int = 0) -> np.ndarray:
    """Roots (3, t, b) that drift one way and walk at random, at up to a metre a second."""
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(-0.7, 1.0, (2, chunks, rows)), 8, axis=1)
    path = np.cumsum(speed / 30, axis=1)
    return np.stack([path[0], np.full_like(path[0], 0.95), path[1]]).astype(np.float32)


@pytest.mark.parametrize("chunks", [600, pytest.param(13_500, marks=pytest.mark.slow, id="an hour")])
def test_a_walker_who_would_be_far_away_stays_within_the_leash(chunks: int) -> None:
    """Two minutes, or an hour, of one who drifts off by a tenth of a metre a second."""
    leash, root = Leash(), wander(chunks)
    state, far, last, speed = leash.init_state(1), 0.0, None, 0.0
    for start in range(0, root.shape[1], 8):
        out = step(leash, root[:, start : start + 8].copy(), state)
        far = max(far, float(np.hypot(out[0], out[2]).max()))
        path = out if last is None else np.concatenate([last, out], 1)
        speed = max(speed, float(np.linalg.norm(np.diff(path[::2], axis=1), axis=0).max()) * 30)
        last = out[:, -1:]
    assert np.hypot(root[0, -1], root[2, -1]) > chunks / 100
    assert far <= 1.0 + 1e-5
    assert speed < 2.0  # no jumps: hardly over the walker's own 1.4 m/s


def test_it_is_the_law_in_plain_words() -> None:
    """Outside witness: one row, frame by frame, of a walker who is drawn back."""
    root = wander(40, seed=3)
    leash = Leash()
    shown = steps(leash, root, leash.init_state(1))[::2, :, 0]
    place, last, pull, slow = root[::2, 0, 0].astype(float), root[::2, 0, 0].astype(float), np.zeros(2), 0.0
    for start in range(0, root.shape[1], 8):
        far = np.hypot(*place)
        out = place / max(far, 1e-6)
        aims = -out * smooth((far - NEAR) / (1 - NEAR)) * PULL_SPEED / 30, smooth((far - EDGE) / (1 - EDGE))
        for frame in range(8):
            share, now = (frame + 1) / 8, root[::2, start + frame, 0].astype(float)
            way, last = now - last, now
            slowed = max(way @ out, 0) * (slow + share * (aims[1] - slow))
            place = place + way + pull + share * (aims[0] - pull) - out * slowed
            np.testing.assert_allclose(shown[:, start + frame], place / max(np.hypot(*place), 1), atol=2e-5)
        place = place / max(np.hypot(*place), 1)
        pull, slow = aims


def smooth(share: float) -> float:
    share = min(max(share, 0.0), 1.0)
    return share * share * (3 - 2 * share)


def test_near_the_start_nothing_is_changed() -> None:
    root = 0.2 * wander(4)
    leash = Leash()
    np.testing.assert_allclose(steps(leash, root, leash.init_state(1)), root, atol=1e-6)


def left_after(far: float, seconds: float = 8.0, **options: float) -> float:
    """Where one stands after that time who began `far` out, on a leash of a metre."""
    leash, root = Leash(), np.zeros((3, 8, 1), np.float32)
    root[0], state = far, leash.init_state(1)
    return [float(step(leash, root.copy(), state, **options)[0, -1, 0]) for _ in range(round(seconds * 30 / 8))][-1]


def test_one_who_stands_far_out_is_drawn_back_unless_feet_are_off_already() -> None:
    assert 0.3 < left_after(0.9) < 0.6
    assert 0.65 < left_after(0.9, seconds=1.0) < 0.78
    assert left_after(0.3) == pytest.approx(0.3, abs=1e-5)
    assert left_after(0.9, lean=0.01) < 0.6
    assert left_after(0.9, lean=0.05) == pytest.approx(0.9, abs=1e-5)


def test_one_who_walks_out_is_slowed_near_the_end_alone() -> None:
    """At 40 cm/s: hardly slower two thirds of the way out, and never past 90 %."""
    leash, root = Leash(), np.zeros((3, 400, 1), np.float32)
    root[0, :, 0] = np.arange(400) * 0.4 / 30
    place = steps(leash, root, leash.init_state(1))[0, :, 0]
    assert np.diff(place)[place[1:] < 0.65].min() * 30 > 0.3
    assert 0.8 < place.max() < 0.9


def test_pinned_rows_do_not_move_and_free_ones_are_free() -> None:
    leash, root = Leash(), wander(3)
    assert not steps(leash, root, leash.init_state(1), is_pinned=True)[::2].any()
    assert np.array_equal(steps(leash, root, leash.init_state(1), radius=0.0), root)


def test_chunks_join_without_a_step() -> None:
    """A steady outward walk: from frame to frame the speed changes by less than 4 cm/s, across chunks too."""
    leash = Leash()
    root = np.zeros((3, 240, 1), np.float32)
    root[0, :, 0] = np.arange(240) * 0.4 / 30
    out = steps(leash, root, leash.init_state(1))
    assert np.abs(np.diff(out[0, :, 0], n=2)).max() * 30 < 0.04
    assert out[0].max() < 1.0


def test_idle_rows_and_neighbours() -> None:
    leash, root = Leash(), wander(2, rows=2)
    state = leash.init_state(2)
    both = steps(leash, root, state, active=np.array([True, False]))
    assert not any(tensor[1].any() for tensor in state.arrays())
    alone = steps(leash, root[:, :, :1], leash.init_state(1))
    assert np.array_equal(both[:, :, :1], alone)
    state.reset(np.array([True, False]))
    assert not any(tensor.any() for tensor in state.arrays())
