from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
import torch

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.pipeline import STAGES
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.motion.motion_chunk import MotionChunk, join


@pytest.fixture(scope="module")
def pipeline(tiny_bundle: Path) -> Pipeline:
    return Pipeline(load_bundle(tiny_bundle), precision="float32")


def stream(pipeline: Pipeline, rows: list[tuple[np.ndarray, int]], active: list[list[bool]]) -> list[list[MotionChunk]]:
    """Chunks of each row; `active` says per step which rows get their next chunk of sound."""
    state = pipeline.init_state(len(rows))
    for row, (_, seed) in enumerate(rows):
        pipeline.reset(state, torch.arange(len(rows)) == row, seed=seed)
    at, out = [0] * len(rows), [[] for _ in rows]
    for on in active:
        audio = np.zeros((len(rows), 6400), np.float32)
        for row in np.flatnonzero(on):
            audio[row] = rows[row][0][at[row] * 6400 : (at[row] + 1) * 6400]
            at[row] += 1
        chunks = pipeline.step(torch.from_numpy(audio), state, torch.tensor(on))
        for row in np.flatnonzero(on):
            out[row].append(chunks[row])
    return out


def same(a: list[MotionChunk], b: list[MotionChunk]) -> bool:
    return all(
        np.allclose(x.rotations, y.rotations, atol=1e-5) and np.allclose(x.root, y.root, atol=1e-5)
        for x, y in zip(a, b, strict=True)
    )


def test_frames_are_unit_quaternions_on_the_rig(pipeline: Pipeline, voice: np.ndarray) -> None:
    [chunks] = stream(pipeline, [(voice, 0)], [[True]] * 7)
    assert chunks[0].rotations.shape == (8, 52, 4)
    norms = np.linalg.norm(np.concatenate([chunk.rotations for chunk in chunks]), axis=-1)
    np.testing.assert_allclose(norms, 1, atol=1e-5)


def test_the_same_seed_repeats_and_another_differs(pipeline: Pipeline, voice: np.ndarray) -> None:
    first, again, other = (stream(pipeline, [(voice, seed)], [[True]] * 6)[0] for seed in (3, 3, 4))
    assert same(first, again)
    assert not same(first, other)


def test_a_neighbour_that_comes_late_and_pauses_changes_nothing(pipeline: Pipeline, voice: np.ndarray) -> None:
    noise = np.random.default_rng(0).standard_normal(48_000).astype(np.float32) * 0.2
    steps = [[True, False], [True, True], [True, False], [True, True], [True, True]]
    both = stream(pipeline, [(voice, 3), (noise, 9)], steps)
    assert same(both[0], stream(pipeline, [(voice, 3)], [[True]] * 5)[0])
    assert same(both[1], stream(pipeline, [(noise, 9)], [[True]] * 3)[0])


def test_what_is_heard_later_does_not_change_what_was_shown(pipeline: Pipeline, voice: np.ndarray) -> None:
    louder = voice.copy()
    louder[3 * 6400 :] = 0.9
    before, after = (stream(pipeline, [(sound, 0)], [[True]] * 6)[0] for sound in (voice, louder))
    assert same(before[:3], after[:3])


def test_every_stage_reports_its_end_in_order(pipeline: Pipeline, voice: np.ndarray) -> None:
    stages: list[str] = []
    pipeline.warm_up()
    pipeline.on_stage = stages.append
    stream(pipeline, [(voice, 0)], [[True]])
    assert tuple(stages) == STAGES


def test_it_says_that_it_compiles_only_when_it_compiles(
    pipeline: Pipeline, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pipeline.warm_up()
    caplog.clear()
    pipeline.warm_up()
    assert "compiling" not in caplog.text

    @numba.njit
    def twice(number: float) -> float:
        return 2 * number

    step = pipeline.step
    monkeypatch.setattr(pipeline, "step", lambda *told: (twice(1.0), step(*told))[1])
    pipeline.warm_up()
    assert caplog.text.count("compiling for this processor") == 1


@pytest.fixture(scope="module")
def default() -> Pipeline:
    return Pipeline(replace(load_bundle("default"), face=None))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_hand_rises_over_the_head_as_far_as_it_is_asked_to(default: Pipeline, seed: int) -> None:
    """By its codes alone, in silence: asked with intensity 1 the hand is raised, asked with a fifth it stays down."""
    action, highest = default.actions["raise_left_hand"], {}
    for intensity in (1.0, 0.2):
        state, everyone = default.init_state(1), torch.ones(1, dtype=torch.bool)
        default.reset(state, everyone, seed=seed)
        made = []
        for chunk in range(8):
            members = intensity * action.members(chunk, action.chunks, default.directive_codes)[None]
            made += default.step(torch.zeros(1, 6400), state, everyone, directive=default.directive(members))
        motion = join(made)
        turns = matrix_from_quaternion(torch.from_numpy(motion.rotations))
        pose = forward_kinematics(HUMANOID, turns, torch.from_numpy(motion.root))
        highest[intensity] = float(pose.positions[:, HUMANOID.index("leftHand"), 1].max())
    assert highest[1.0] > 1.6
    assert highest[0.2] < 1.2


def test_a_generator_that_knows_no_exemplars_is_asked_by_its_logits_alone(
    pipeline: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Random weights, eight codes: at intensity 1 the asked one is always drawn, at 0.15 about half the time."""
    seen, step = [], pipeline.generator.step
    monkeypatch.setattr(pipeline.generator, "step", lambda *x, **named: (seen.append(step(*x, **named)), seen[-1])[1])
    shares = []
    for intensity in (1.0, 0.15):
        state, everyone = pipeline.init_state(8), torch.ones(8, dtype=torch.bool)
        for row in range(8):
            pipeline.reset(state, torch.arange(8) == row, seed=row)
        seen.clear()
        members = torch.zeros(8, pipeline.directive_codes)
        members[:, 3] = intensity
        for _ in range(40):
            pipeline.step(torch.zeros(8, 6400), state, everyone, directive=pipeline.directive(members))
        shares.append(float((torch.stack(seen)[..., 1, 0] == 3).float().mean()))
    assert shares[0] > 0.98
    assert 0.35 < shares[1] < 0.7
