"""Fixtures that several rooms share, and the loop that runs coroutine tests."""

import asyncio
import inspect
from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar import checkpoint
from echoavatar.models.audio import AudioCodec, CodecConfig
from echoavatar.models.generator import Generator, GeneratorConfig
from echoavatar.models.tokenizer import BodyTokenizer, MotionTokenizerConfig
from echoavatar.models.tokenizer.body import body_config
from echoavatar.models.tokens import TokenLayout
from echoavatar.motion.kinematics import HUMANOID, to_features
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle

CARD: dict[str, object] = {
    "data": "none, random weights",
    "command": "tests/conftest.py",
    "licence": "Apache-2.0",
}


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine on a loop of its own, for a minute at most."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    given = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    asyncio.run(asyncio.wait_for(pyfuncitem.obj(**given), 60))
    return True


@pytest.fixture(scope="session")
def tiny_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle of random weights, small enough to run in milliseconds; its statistics are those of a standing body."""
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("bundle")
    codec = AudioCodec(CodecConfig(filters=2, width=8, codes=16))
    checkpoint.save(folder / "codec", config=codec.config, weights=codec.state_dict(), card=CARD)
    template = MotionTokenizerConfig(features=1, width=16, heads=2, layers=2, codes=8)
    tokenizer = BodyTokenizer(body_config(HUMANOID, template))
    still = torch.eye(3).expand(2, HUMANOID.joints, 3, 3)
    tokenizer.mean.copy_(to_features(HUMANOID, still, HUMANOID.offsets[0].expand(2, 3))[0])
    tokenizer.std.fill_(0.02)
    for name, book in tokenizer.named_buffers():
        if name.endswith("codebook"):
            book.normal_()
    tokenizer.save(folder / "tokenizer", CARD)
    layout = TokenLayout.compact(audio_codes=16, motion_layers=2, motion_codes=8)
    config = GeneratorConfig(layout=layout, window_chunks=3, width=16, layers=1, heads=2, kv_heads=1, mlp=32)
    Generator(config).save(folder / "generator", CARD)
    return folder


@pytest.fixture(scope="session")
def voice() -> np.ndarray:
    """Two seconds of something with onsets, 24 kHz mono."""
    time = np.arange(48_000) / 24_000
    return (0.3 * np.sin(2 * np.pi * 180 * time) * (np.sin(2 * np.pi * 2 * time) > 0)).astype(np.float32)


@pytest.fixture(scope="session")
def swaying() -> tuple[np.ndarray, np.ndarray]:
    """Rotation matrices (96, 52, 3, 3) and root (96, 3) of a body that sways with planted feet."""
    turns = torch.zeros(96, HUMANOID.joints, 3)
    turns[:, HUMANOID.index("spine"), 2] = 0.2 * torch.sin(torch.arange(96) / 9)
    return matrix_from_axis_angle(turns).numpy(), HUMANOID.offsets[:1].expand(96, 3).numpy()
