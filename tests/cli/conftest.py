import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar.models.face import FaceConfig, MelConfig
from echoavatar.motion.formats.tables import write_npz
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.models.face.model import FaceModel


@pytest.fixture(scope="module")
def bundle_with_face(tiny_bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny bundle and a tiny face whose curves stay near 0.3."""
    folder = tmp_path_factory.mktemp("faced") / "bundle"
    shutil.copytree(tiny_bundle, folder)
    torch.manual_seed(0)
    model = FaceModel(
        FaceConfig(
            encoder=MelConfig(width=8, blocks=1), width=8, layers=1, heads=2, condition=8, head_width=8, context=8
        )
    )
    model.mean.fill_(0.3)
    model.std.fill_(0.05)
    model.save(folder / "face", {"data": "none"})
    return folder


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Twelve frames of the rest pose."""
    rotations = np.zeros((12, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    root = np.tile(HUMANOID.offsets[:1], (12, 1))
    write_npz(tmp_path / "take.npz", Motion(HUMANOID, rotations, root, 30.0))
    return tmp_path / "take.npz"
