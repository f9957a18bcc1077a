import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
import torch
from tests.models.face.tiny import make
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline, PipelineState, load_bundle
from echoavatar.engine.pipeline import pipeline as room
from echoavatar.engine.pipeline.actions import Action, ActionLibrary
from echoavatar.engine.pipeline.bundle import Bundle
from echoavatar.engine.pipeline.pipeline import STAGES
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.errors import EchoAvatarError
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar_lab.models.generator.model import Generator

EVERYONE = np.ones(1, np.bool_)
HOST, GPU = torch.device("cpu"), torch.device("cuda", 0)
MAY_MIX = {Tensor.to, Tensor.copy_, Tensor.__getitem__, Tensor.__setitem__}  # copies, and masks from the host


@pytest.fixture(scope="module")
def pipeline(tiny_bundle: Path) -> Pipeline:
    return Pipeline(load_bundle(tiny_bundle), precision="float32")


def stream(pipeline: Pipeline, rows: list[tuple[np.ndarray, int]], active: list[list[bool]]) -> list[list[MotionChunk]]:
    """Chunks of each row; `active` says per step which rows get their next chunk of sound."""
    state = pipeline.init_state(len(rows))
    for row, (_, seed) in enumerate(rows):
        pipeline.reset(state, np.arange(len(rows)) == row, seed=seed)
    at, out = [0] * len(rows), [[] for _ in rows]
    for on in active:
        audio = np.zeros((len(rows), 6400), np.float32)
        for row in np.flatnonzero(on):
            audio[row] = rows[row][0][at[row] * 6400 : (at[row] + 1) * 6400]
            at[row] += 1
        chunks = pipeline.step(audio, state, np.array(on))
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


def pipeline_of(folder: Path, **settings: float) -> Pipeline:
    """The tiny bundle with a face, and the default settings but for these."""
    torch.manual_seed(2)
    bundle = replace(load_bundle(folder).having(face=make().float()), runtime=Runtime(**settings))
    return Pipeline(bundle, precision="float32")


@pytest.fixture(scope="module")
def with_face(tiny_bundle: Path) -> Pipeline:
    return pipeline_of(tiny_bundle)


def opened(with_face: Pipeline, seed: int, options: MotionOptions = FREE) -> PipelineState:
    state = with_face.init_state(1)
    with_face.reset(state, EVERYONE, seed=seed, options=options)
    return state


def heard(with_face: Pipeline, state: PipelineState, sound: np.ndarray) -> list[MotionChunk]:
    blocks = np.split(sound[None, : len(sound) // 6400 * 6400], len(sound) // 6400, 1)
    return [with_face.step(block, state, EVERYONE)[0] for block in blocks]


def shown(chunks: list[MotionChunk]) -> list[np.ndarray]:
    return [array for chunk in chunks for array in chunk if array is not None]


def decoded(monkeypatch: pytest.MonkeyPatch, with_face: Pipeline) -> list[np.ndarray]:
    """What its tokenizer decodes from now on."""
    seen: list[np.ndarray] = []
    decode = with_face.decoder.step

    def tapped(*args: Any) -> np.ndarray:
        seen.append(decode(*args).copy())
        return seen[-1]

    monkeypatch.setattr(with_face.decoder, "step", tapped)
    return seen


def test_it_decodes_and_speaks_as_one_that_has_heard_two_seconds_of_silence(
    tiny_bundle: Path, with_face: Pipeline, voice: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eight chunks of it, as seven are less; seed 0 is the one that the silence was heard with."""
    with_face.warm_up()
    cold = pipeline_of(tiny_bundle, lead_in_s=0.0)
    waited, at_once = decoded(monkeypatch, cold), decoded(monkeypatch, with_face)
    silence = np.zeros(8 * 6400, np.float32)
    witness = heard(cold, opened(cold, 0), np.concatenate([silence, voice]))[8:]
    begun = heard(with_face, opened(with_face, 0), voice)
    assert len(at_once) == len(begun) == 7
    for own, other in zip(at_once, waited[8:], strict=True):
        assert np.array_equal(own, other)
    for chunk, other in zip(begun, witness, strict=True):
        assert chunk.face is not None
        assert other.face is not None
        np.testing.assert_array_equal(chunk.face, other.face)


@pytest.mark.parametrize(
    "options", [FREE, MotionOptions(in_place=True), MotionOptions(leash_m=1), MotionOptions(upper_body=True)]
)
def test_it_begins_over_the_spot_whatever_was_asked_of_it(
    with_face: Pipeline, voice: np.ndarray, options: MotionOptions
) -> None:
    chunks = heard(with_face, opened(with_face, 5, options), voice)
    assert np.abs(chunks[0].root[0, [0, 2]]).max() < 1e-3
    if options.in_place:
        assert not np.concatenate([chunk.root[:, [0, 2]] for chunk in chunks]).any()


def test_motion_is_the_seeds_own_whoever_came_before(tiny_bundle: Path, voice: np.ndarray) -> None:
    """In the first session of a pipeline, in a used row, and in another row beside a stranger's."""
    with_face = pipeline_of(tiny_bundle)
    first = shown(heard(with_face, opened(with_face, 3), voice))
    used = opened(with_face, 9)
    other = shown(heard(with_face, used, voice))
    with_face.reset(used, EVERYONE, seed=3)
    again = shown(heard(with_face, used, voice))
    state = with_face.init_state(2)
    with_face.reset(state, np.array([True, False]), seed=9)
    before = [tensor[:1].copy() for tensor in state.arrays()]
    with_face.reset(state, np.array([False, True]), seed=3)
    assert all(np.array_equal(a, b[:1]) for a, b in zip(before, state.arrays(), strict=True))
    beside = shown(heard(with_face, state.rows(slice(1, 2)), voice))
    for own, then, there in zip(first, again, beside, strict=True):
        np.testing.assert_array_equal(then, own)
        np.testing.assert_array_equal(there, own)
    assert not all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_after_the_warm_up_nobody_waits(tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_face = pipeline_of(tiny_bundle)
    with_face.warm_up()
    monkeypatch.setattr(with_face, "step", lambda *args: pytest.fail("a session waits"))
    assert opened(with_face, 1).seeds.tolist() == [1]


def test_without_a_lead_in_it_has_heard_nothing(tiny_bundle: Path) -> None:
    with_face = pipeline_of(tiny_bundle, lead_in_s=0.0)
    state, fresh = opened(with_face, 0), with_face.init_state(1)
    assert all(np.array_equal(a, b) for a, b in zip(state.arrays(), fresh.arrays(), strict=True))


def test_one_that_forgets_goes_on_from_there_and_stays_where_it_is(with_face: Pipeline, voice: np.ndarray) -> None:
    state, fresh = opened(with_face, 4), opened(with_face, 4)
    heard(with_face, state, voice)
    body = [tensor.copy() for tensor in state.post.arrays()]
    with_face.restart_generator(state, EVERYONE)
    for own, new in zip(state.generator.arrays(), fresh.generator.arrays(), strict=True):
        assert np.array_equal(own, new)
    assert all(np.array_equal(a, b) for a, b in zip(body, state.post.arrays(), strict=True))


def test_threads_that_come_at_once_make_the_warm_start_once(tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline, together, made = Pipeline(load_bundle(tiny_bundle)), threading.Barrier(4), list[PipelineState]()
    state, make = pipeline.init_state(4), pipeline._after_silence

    def slowly() -> PipelineState:
        made.append(make())
        threading.Event().wait(0.05)
        return made[-1]

    monkeypatch.setattr(pipeline, "_after_silence", slowly)

    def open_row(row: int) -> None:
        together.wait()
        pipeline.reset(state, np.arange(4) == row, seed=row)

    threads = [threading.Thread(target=open_row, args=(row,)) for row in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    [start] = made
    for own, new in zip(state.generator.arrays(), start.generator.arrays(), strict=True):
        assert np.array_equal(own, np.broadcast_to(new, own.shape))


class There(Tensor):
    """A tensor that is said to lie on the GPU."""


class PretendedGpu(TorchFunctionMode):
    """Computes on the host, keeps account of what lies where, and refuses to mix the two."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        there = [leaf for leaf in tensors if isinstance(leaf, There)]
        if func == Tensor.device.__get__:
            return GPU if there else HOST
        if func is torch._C._nn._parse_to:
            return func(*args, **kwargs)
        if func is torch._has_compatible_shallow_copy_type:
            return not there
        assert not (there and func is Tensor.numpy), "a GPU's memory is not the host's"
        here = [tuple(leaf.shape) for leaf in tensors if not isinstance(leaf, There) and leaf.dim()]
        assert not (there and here) or func in MAY_MIX, f"{func.__name__}: {here} is on the host"
        out = func(*tree_map(_plain, args), **tree_map(_plain, kwargs))
        if not (_goes_there(func, args, kwargs) if func in (Tensor.to, Tensor.cpu) else there or _names(kwargs)):
            return out
        return tree_map(lambda leaf: leaf.as_subclass(There) if isinstance(leaf, Tensor) else leaf, out)


def _goes_there(func: Any, args: Any, kwargs: Any) -> bool:
    """Whether the copy of the first argument lies on the GPU."""
    if func is Tensor.cpu:
        return False
    named = [leaf for leaf in (*args[1:], kwargs.get("device")) if isinstance(leaf, torch.device | Tensor | str)]
    target = named[-1] if named else args[0]
    return isinstance(target, There) if isinstance(target, Tensor) else torch.device(target).type == "cuda"


def _names(kwargs: Any) -> bool:
    return kwargs.get("device") is not None and torch.device(kwargs["device"]).type == "cuda"


def _plain(leaf: Any) -> Any:
    if isinstance(leaf, There):
        return leaf.as_subclass(Tensor)
    return HOST if isinstance(leaf, torch.device) else leaf


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[PretendedGpu]:
    monkeypatch.setattr(room, "find_device", lambda name: name)
    torch.__future__.set_overwrite_module_params_on_conversion(True)
    yield PretendedGpu()
    torch.__future__.set_overwrite_module_params_on_conversion(False)


def bundle_of(folder: Path, order: str) -> Bundle:
    """The tiny bundle with one action, its generator in either sequence order."""
    bundle = load_bundle(folder)
    torch.manual_seed(1)
    generator = Generator(bundle.generator.config.model_copy(update={"sequence": order})).eval()
    actions = ActionLibrary({"wave": Action("wave", (0, 1, 2, 3), (0, 2))})
    return replace(bundle.having(generator=generator), actions=actions)


def moved(pipeline: Pipeline, voice: np.ndarray) -> np.ndarray:
    """Two sessions in one batch: one does an action, the other takes back what it heard last and hears it again."""
    engine = Engine(pipeline, seats=2)
    sessions = [engine.open(seed=seed) for seed in (3, 4)]
    sessions[0].act("wave")
    for session in sessions:
        session.push(voice)
    while engine.tick():
        pass
    sessions[1].clear(20_000)
    sessions[1].push(voice[20_000:])
    while engine.tick():
        pass
    return np.concatenate([join(list(session)).rotations for session in sessions])


@pytest.mark.parametrize("order", ["interleaved", "prefix"])
def test_a_gpu_gives_the_motion_of_the_host(
    tiny_bundle: Path, voice: np.ndarray, gpu: PretendedGpu, order: str
) -> None:
    on_host = moved(Pipeline(bundle_of(tiny_bundle, order), precision="float32"), voice)
    with gpu:
        pipeline = Pipeline(bundle_of(tiny_bundle, order), precision="float32", device="cuda:0")
        assert pipeline.device == "cuda:0"
        assert isinstance(pipeline.init_state(1).codec.hidden, There)
        on_gpu = moved(pipeline, voice)
    np.testing.assert_allclose(on_gpu, on_host, atol=1e-5)


def test_the_pretended_one_refuses_to_mix(gpu: PretendedGpu) -> None:
    with gpu:
        there = nn.Linear(2, 2).to(GPU)
        assert there(torch.zeros(1, 2, device=GPU)).device == GPU
        with pytest.raises(AssertionError, match="is on the host"):
            there(torch.zeros(1, 2))
        with pytest.raises(AssertionError, match="not the host's"):
            torch.zeros(1).to(GPU).numpy()


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is one")
def test_a_missing_gpu_is_said(tiny_bundle: Path) -> None:
    with pytest.raises(EchoAvatarError, match=r"no CUDA device 0: .*; --device cpu runs everywhere"):
        Pipeline(load_bundle(tiny_bundle), device="cuda")


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("order", ["interleaved", "prefix"])
def test_a_true_gpu_gives_the_motion_of_the_host(tiny_bundle: Path, voice: np.ndarray, order: str) -> None:
    there, here = (
        moved(Pipeline(bundle_of(tiny_bundle, order), precision="float32", device=name), voice)
        for name in ("cuda", "cpu")
    )
    np.testing.assert_allclose(there, here, atol=1e-3)


@pytest.fixture(scope="module")
def default() -> Pipeline:
    return Pipeline(load_bundle("default").without(["face"]))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_hand_rises_over_the_head_as_far_as_it_is_asked_to(default: Pipeline, seed: int) -> None:
    """By its codes alone, in silence: asked with intensity 1 the hand is raised, asked with a fifth it stays down."""
    action, highest = default.actions["raise_left_hand"], {}
    for intensity in (1.0, 0.2):
        state, everyone = default.init_state(1), np.ones(1, np.bool_)
        default.reset(state, everyone, seed=seed)
        made = []
        for chunk in range(16):
            members = intensity * action.members(chunk, action.chunks, default.directive_codes)[None]
            silence = np.zeros((1, default.chunk.samples), np.float32)
            made += default.step(silence, state, everyone, directive=default.directive(members))
        motion = join(made)
        turns = matrix_from_quaternion(motion.rotations)
        pose = forward_kinematics(HUMANOID, turns, motion.root)
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
        state, everyone = pipeline.init_state(8), np.ones(8, np.bool_)
        for row in range(8):
            pipeline.reset(state, np.arange(8) == row, seed=row)
        seen.clear()
        members = np.zeros((8, pipeline.directive_codes), np.float32)
        members[:, 3] = intensity
        for _ in range(40):
            pipeline.step(np.zeros((8, 6400), np.float32), state, everyone, directive=pipeline.directive(members))
        shares.append(float((np.stack(seen)[..., 1, 0] == 3).mean()))
    assert shares[0] > 0.98
    assert 0.35 < shares[1] < 0.7
