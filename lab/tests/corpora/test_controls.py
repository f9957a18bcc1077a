from dataclasses import fields, replace

import numpy as np
import pytest

from echoavatar_lab.corpora.controls import (
    Controls,
    blended,
    concatenated,
    critically_damped,
    minimum_jerk,
    mirrored,
    neutral,
    smoothed,
    wander,
    wrists_over,
)


def any_controls(frames: int = 7) -> Controls:
    table = neutral(frames).packed()
    return Controls.unpacked(table + np.random.default_rng(0).normal(0, 0.1, table.shape))


def same(a: Controls, b: Controls) -> bool:
    return all(np.allclose(getattr(a, f.name), getattr(b, f.name), atol=1e-6) for f in fields(a))


def test_packing_and_cutting_lose_nothing():
    controls = any_controls()
    assert same(Controls.unpacked(controls.packed()), controls)
    assert same(concatenated([controls[:3], controls[3:]]), controls)
    assert len(controls[2:5]) == 3


def test_mirroring_twice_gives_the_original_and_neutral_is_symmetric():
    controls = any_controls()
    assert same(mirrored(mirrored(controls)), controls)
    assert not same(mirrored(controls), controls)
    assert same(mirrored(neutral(2)), neutral(2))


def test_blending_follows_the_weight_of_each_frame():
    a = neutral(3)
    b = replace(a, head=a.head + 1)
    mixed = blended(a, b, np.array([0.0, 0.25, 1.0]))
    np.testing.assert_allclose(mixed.head[:, 0] - a.head[:, 0], [0, 0.25, 1], atol=1e-6)


def test_minimum_jerk_starts_and_ends_at_rest():
    phase = np.linspace(-0.5, 1.5, 401)
    progress = minimum_jerk(phase)
    assert progress[0] == 0
    assert progress[-1] == 1
    assert progress[200] == pytest.approx(0.5)
    speed = np.gradient(progress.astype(float), phase)
    assert speed.max() == pytest.approx(1.875, abs=0.01)
    assert abs(speed[100]) < 2e-3


def test_damping_is_causal_and_smoothing_keeps_the_ends():
    step = np.zeros((90, 1), np.float32)
    step[30:] = 1
    damped = critically_damped(step, 0.5)
    assert np.all(damped[:30] == 0)
    assert 0.85 < damped[45, 0] < 1.0
    assert damped.max() <= 1.0 + 1e-6
    blurred = smoothed(step, 0.1)
    assert blurred[0] == 0
    assert blurred[-1] == 1
    assert 0 < blurred[29, 0] < 0.5


def test_wandering_has_unit_deviation_and_no_jumps():
    drift = wander(30_000, 2, period=2.0, rng=np.random.default_rng(3))
    assert np.allclose(drift.std(axis=0), 1.0, atol=0.15)
    assert np.abs(np.diff(drift, axis=0)).max() < 0.5


def test_a_hand_passes_its_shoulder_in_an_arc_and_keeps_its_speed_at_a_join():
    """From in front of the shoulder to behind it: along a straight line the hand would meet the shoulder."""
    step = np.array([0.0, 0.02, 0.0], np.float32)
    old = np.stack([np.tile(np.array([0.1, 0.0, 0.4], np.float32), (2, 1)) + k * step for k in range(2)])
    new = np.tile(np.array([0.1, 0.0, -0.4], np.float32), (40, 2, 1))
    over = wrists_over(old, new, 20)
    np.testing.assert_allclose(over[0], old[1], atol=1e-5)
    np.testing.assert_allclose(over[1] - over[0], old[1] - old[0], atol=0.006)
    np.testing.assert_allclose(over[-1], new[-1], atol=1e-5)
    assert np.linalg.norm(over, axis=-1).min() > 0.38
