"""Checkpoints and arrays of strangers: no reader makes a module or an array larger than the file vouches for."""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.motion.formats import tables
from echoavatar_lab import checkpoint
from echoavatar_lab.align.audio_reward import AudioMotion
from echoavatar_lab.align.quality import QualityConfig, QualityReward
from echoavatar_lab.data import Clip
from echoavatar_lab.datasets.prepare_dataset import motion_header
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder, MotionEncoderConfig
from echoavatar_lab.evaluation.report import read_embeddings
from echoavatar_lab.foreign.smpl import read_smplx
from echoavatar_lab.models.face.clip import FaceClip
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.tables.skeleton_convolution import SkeletonConvolution, SkeletonConvolutionConfig


def alignment() -> AudioMotion:
    books = torch.randn(2, 8, 16), torch.randn(3, 2, 8, 4)
    return AudioMotion.from_codebooks(*books, width=16, heads=2, layers=1, size=48)


SMALL = SkeletonConvolutionConfig(channels=(10, 10), groups=10)
MODELS: list[tuple[Any, Any, dict[str, object]]] = [
    (QualityReward, lambda: QualityReward(QualityConfig(features=12, width=16, heads=2)), {"blocks": 300}),
    (AudioMotion, alignment, {"layers": 300}),
    (MotionEncoder, lambda: MotionEncoder(MotionEncoderConfig(features=12, width=8, latent=8)), {"width": 2048}),
    (SkeletonConvolution, lambda: SkeletonConvolution(SMALL), {"channels": [10, 60]}),
]


@pytest.mark.parametrize(("kind", "make", "change"), MODELS, ids=lambda value: getattr(value, "__name__", ""))
def test_no_module_is_built_that_outgrows_its_weights(tmp_path: Path, kind: Any, make: Any, change: Any) -> None:
    model = make()
    checkpoint.save(tmp_path, config=model.config, weights=model.state_dict(), card={})
    assert isinstance(kind.load(tmp_path), kind)
    config = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps(config | change))
    with pytest.raises(CheckpointError, match=r"than model\.safetensors has"):
        kind.load(tmp_path)


READERS: dict[str, Callable[[Path], object]] = {
    "clip": Clip.load,
    "face clip": FaceClip.load,
    "tokens": TokenClip.load,
    "embeddings": read_embeddings,
    "smplx": read_smplx,
    "header": motion_header,
}
KEYS = ("audio", "motion", "poses", "trans", "audio_codes", "motion_codes", "curves", "rotations", "root", "domain")
KEYS += ("name", "split", "channels")


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_an_npz_that_unpacks_to_too_much_is_refused(tmp_path: Path, monkeypatch: Any, read: Any) -> None:
    monkeypatch.setattr(tables, "ARRAYS_BYTES", 1 << 18)
    np.savez_compressed(tmp_path / "bomb.npz", **{key: np.zeros((9_000, 3), np.float32) for key in KEYS})
    assert (tmp_path / "bomb.npz").stat().st_size < 1 << 18
    with pytest.raises(EchoAvatarError, match="unpacks to"):
        read(tmp_path / "bomb.npz")


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_an_array_whose_header_lies_is_refused(tmp_path: Path, read: Any) -> None:
    """The header asks for a terabyte; the file has twelve bytes."""
    plain = io.BytesIO()
    np.save(plain, np.zeros(3, np.float32))
    lying = plain.getvalue().replace(b"(3,), }" + b" " * 11, b"(250000000000,), }")
    assert lying != plain.getvalue()
    with zipfile.ZipFile(tmp_path / "lies.npz", "w") as archive:
        for key in KEYS:
            archive.writestr(f"{key}.npy", lying)
    with pytest.raises(EchoAvatarError, match="there is less|holds no arrays"):
        read(tmp_path / "lies.npz")
