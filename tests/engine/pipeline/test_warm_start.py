"""A session begins as one that has stood through silence, and waits for none of it."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tests.models.face.tiny import make

from echoavatar.engine.pipeline import Pipeline, PipelineState, load_bundle
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.engine.pipeline.warm_start import WarmStart, copy_row
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.nn import StreamState

EVERYONE = torch.ones(1, dtype=torch.bool)


def pipeline_of(folder: Path, **settings: float) -> Pipeline:
    """The tiny bundle with a face, and the default settings but for these."""
    torch.manual_seed(2)
    bundle = replace(load_bundle(folder), face=make().float(), runtime=Runtime(**settings))
    return Pipeline(bundle, precision="float32")


@pytest.fixture(scope="module")
def pipeline(tiny_bundle: Path) -> Pipeline:
    return pipeline_of(tiny_bundle)


def opened(pipeline: Pipeline, seed: int, options: MotionOptions = FREE) -> PipelineState:
    state = pipeline.init_state(1)
    pipeline.reset(state, EVERYONE, seed=seed, options=options)
    return state


def heard(pipeline: Pipeline, state: PipelineState, sound: np.ndarray) -> list[MotionChunk]:
    blocks = torch.from_numpy(sound[: len(sound) // 6400 * 6400])[None].split(6400, 1)
    return [pipeline.step(block, state, EVERYONE)[0] for block in blocks]


def shown(chunks: list[MotionChunk]) -> list[np.ndarray]:
    return [array for chunk in chunks for array in chunk if array is not None]


def decoded(monkeypatch: pytest.MonkeyPatch, pipeline: Pipeline) -> list[torch.Tensor]:
    """What its tokenizer decodes from now on."""
    seen: list[torch.Tensor] = []
    decode = pipeline.tokenizer.decode_step

    def tapped(*args: Any) -> torch.Tensor:
        seen.append(decode(*args).clone())
        return seen[-1]

    monkeypatch.setattr(pipeline.tokenizer, "decode_step", tapped)
    return seen


def test_it_decodes_and_speaks_as_one_that_has_heard_two_seconds_of_silence(
    tiny_bundle: Path, pipeline: Pipeline, voice: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eight chunks of it, as seven are less; seed 0 is the one that the silence was heard with."""
    pipeline.warm_up()
    cold = pipeline_of(tiny_bundle, lead_in_s=0.0)
    waited, at_once = decoded(monkeypatch, cold), decoded(monkeypatch, pipeline)
    silence = np.zeros(8 * 6400, np.float32)
    witness = heard(cold, opened(cold, 0), np.concatenate([silence, voice]))[8:]
    begun = heard(pipeline, opened(pipeline, 0), voice)
    assert len(at_once) == len(begun) == 7
    for own, other in zip(at_once, waited[8:], strict=True):
        assert torch.equal(own, other)
    for chunk, other in zip(begun, witness, strict=True):
        assert chunk.face is not None
        assert other.face is not None
        np.testing.assert_array_equal(chunk.face, other.face)


@pytest.mark.parametrize(
    "options", [FREE, MotionOptions(in_place=True), MotionOptions(leash_m=1), MotionOptions(upper_body=True)]
)
def test_it_begins_over_the_spot_whatever_was_asked_of_it(
    pipeline: Pipeline, voice: np.ndarray, options: MotionOptions
) -> None:
    chunks = heard(pipeline, opened(pipeline, 5, options), voice)
    assert np.abs(chunks[0].root[0, [0, 2]]).max() < 1e-3
    if options.in_place:
        assert not np.concatenate([chunk.root[:, [0, 2]] for chunk in chunks]).any()


def test_motion_is_the_seeds_own_whoever_came_before(tiny_bundle: Path, voice: np.ndarray) -> None:
    """In the first session of a pipeline, in a used row, and in another row beside a stranger's."""
    pipeline = pipeline_of(tiny_bundle)
    first = shown(heard(pipeline, opened(pipeline, 3), voice))
    used = opened(pipeline, 9)
    other = shown(heard(pipeline, used, voice))
    pipeline.reset(used, EVERYONE, seed=3)
    again = shown(heard(pipeline, used, voice))
    state = pipeline.init_state(2)
    pipeline.reset(state, torch.tensor([True, False]), seed=9)
    before = [tensor[:1].clone() for tensor in state.tensors()]
    pipeline.reset(state, torch.tensor([False, True]), seed=3)
    assert all(torch.equal(a, b[:1]) for a, b in zip(before, state.tensors(), strict=True))
    beside = shown(heard(pipeline, state.rows(slice(1, 2)), voice))
    for own, then, there in zip(first, again, beside, strict=True):
        np.testing.assert_array_equal(then, own)
        np.testing.assert_array_equal(there, own)
    assert not all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_after_the_warm_up_nobody_waits(tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline = pipeline_of(tiny_bundle)
    pipeline.warm_up()
    monkeypatch.setattr(pipeline, "step", lambda *args: pytest.fail("a session waits"))
    assert int(opened(pipeline, 1).seeds) == 1


def test_without_a_lead_in_it_has_heard_nothing(tiny_bundle: Path) -> None:
    pipeline = pipeline_of(tiny_bundle, lead_in_s=0.0)
    state, fresh = opened(pipeline, 0), pipeline.init_state(1)
    assert all(torch.equal(a, b) for a, b in zip(state.tensors(), fresh.tensors(), strict=True))


def test_one_that_forgets_goes_on_from_there_and_stays_where_it_is(pipeline: Pipeline, voice: np.ndarray) -> None:
    state, fresh = opened(pipeline, 4), opened(pipeline, 4)
    heard(pipeline, state, voice)
    body = [tensor.clone() for tensor in state.post.tensors()]
    pipeline.restart_generator(state, EVERYONE)
    for own, new in zip(state.generator.tensors(), fresh.generator.tensors(), strict=True):
        assert torch.equal(own, new)
    assert all(torch.equal(a, b) for a, b in zip(body, state.post.tensors(), strict=True))


class Counted(StreamState):
    def __init__(self, number: torch.Tensor) -> None:
        self.number = number


def test_threads_that_come_at_once_make_it_once() -> None:
    made, together = [], threading.Barrier(4)

    def slowly() -> Counted:
        made.append(threading.get_ident())
        threading.Event().wait(0.05)
        return Counted(torch.tensor([len(made)]))

    beginning, state = WarmStart(), Counted(torch.zeros(4, dtype=torch.int64))

    def open_row(row: int) -> None:
        together.wait()
        copy_row(state, torch.arange(4) == row, beginning.state(slowly))

    threads = [threading.Thread(target=open_row, args=(row,)) for row in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1
    assert state.number.tolist() == [1, 1, 1, 1]
