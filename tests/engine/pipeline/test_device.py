"""Where the models run. Needs no GPU: a pretended one lies in the host's memory and refuses what a true one would."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline import pipeline as room
from echoavatar.engine.pipeline.actions import Action, ActionLibrary
from echoavatar.engine.pipeline.bundle import Bundle
from echoavatar.engine.pipeline.device import find_device
from echoavatar.errors import EchoAvatarError
from echoavatar.models.generator import Generator
from echoavatar.motion.motion_chunk import join

HOST, GPU = torch.device("cpu"), torch.device("cuda", 0)
MAY_MIX = {Tensor.to, Tensor.copy_, Tensor.__getitem__, Tensor.__setitem__}  # copies, and masks from the host


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
    monkeypatch.setattr(room, "find_device", torch.device)
    torch.__future__.set_overwrite_module_params_on_conversion(True)
    yield PretendedGpu()
    torch.__future__.set_overwrite_module_params_on_conversion(False)


def bundle_of(folder: Path, order: str) -> Bundle:
    """The tiny bundle with one action, its generator in either sequence order."""
    bundle = load_bundle(folder)
    torch.manual_seed(1)
    generator = Generator(bundle.generator.config.model_copy(update={"sequence": order})).eval()
    actions = ActionLibrary({"wave": Action("wave", (0, 1, 2, 3), (0, 2))})
    return replace(bundle, generator=generator, actions=actions)


def shown(pipeline: Pipeline, voice: np.ndarray) -> np.ndarray:
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
    on_host = shown(Pipeline(bundle_of(tiny_bundle, order), precision="float32"), voice)
    with gpu:
        pipeline = Pipeline(bundle_of(tiny_bundle, order), precision="float32", device="cuda:0")
        assert pipeline.device == GPU
        assert isinstance(next(pipeline.codec.parameters()), There)
        on_gpu = shown(pipeline, voice)
    np.testing.assert_allclose(on_gpu, on_host, atol=1e-5)


def test_the_pretended_one_refuses_to_mix(gpu: PretendedGpu) -> None:
    with gpu:
        there = nn.Linear(2, 2).to(GPU)
        assert there(torch.zeros(1, 2, device=GPU)).device == GPU
        with pytest.raises(AssertionError, match="is on the host"):
            there(torch.zeros(1, 2))
        with pytest.raises(AssertionError, match="not the host's"):
            torch.zeros(1).to(GPU).numpy()


def test_a_person_says_where() -> None:
    assert find_device("cpu") == HOST
    assert find_device("auto").type == ("cuda" if torch.cuda.is_available() else "cpu")
    for word in ("gpu", "cuda:first", "cpu:1"):
        with pytest.raises(EchoAvatarError, match="say cpu, cuda"):
            find_device(word)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is one")
def test_a_missing_gpu_is_said(tiny_bundle: Path) -> None:
    with pytest.raises(EchoAvatarError, match=r"no CUDA device 0: .*; --device cpu runs everywhere"):
        Pipeline(load_bundle(tiny_bundle), device="cuda")


@pytest.mark.gpu
@pytest.mark.parametrize("order", ["interleaved", "prefix"])
def test_a_true_gpu_gives_the_motion_of_the_host(tiny_bundle: Path, voice: np.ndarray, order: str) -> None:
    there, here = (
        shown(Pipeline(bundle_of(tiny_bundle, order), precision="float32", device=name), voice)
        for name in ("cuda", "cpu")
    )
    np.testing.assert_allclose(there, here, atol=1e-3)
