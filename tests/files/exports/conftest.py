from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.bodies import make_rigs
from tests.files.exports.moving import clapping

from echoavatar.files.exports import Take


@pytest.fixture(scope="session")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    return make_rigs(tmp_path_factory.mktemp("rigs"))


@pytest.fixture(scope="session")
def take() -> Take:
    """Six seconds of claps and steps, and a face that wanders."""
    motion = clapping()
    draw = np.random.default_rng(0)
    rates, phases = draw.uniform(1, 6, 52), draw.uniform(0, 6, 52)
    face = 0.5 + 0.5 * np.sin(np.arange(motion.frames)[:, None] / 30 * rates + phases)
    return Take(motion, face.astype(np.float32), np.zeros(motion.frames * 800, np.float32))


@pytest.fixture(scope="session")
def short(take: Take) -> Take:
    return Take(take.motion.cut(0, 45), take.face[:45], None)  # type: ignore[index]
