"""Files with bits flipped, bytes cut out and numbers made large: each reader answers, or refuses with one error."""

import contextlib
import resource
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile
import torch
from tests.files.exports.bodies import child

from echoavatar import checkpoint
from echoavatar.errors import EchoAvatarError
from echoavatar.evaluation.metrics.motion_encoder import MotionEncoder, MotionEncoderConfig
from echoavatar.files.exports import read_rig
from echoavatar.files.foreign_files import read_pickled_array, read_tensors
from echoavatar.models.audio.io import read_audio, write_wav
from echoavatar.motion.ik.gltf_rig import read_gltf_rig
from echoavatar.motion.ik.skinned import read_skinned
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.bvh import read_bvh, write_bvh
from echoavatar.motion.kinematics.tables import read_npz, write_npz
from echoavatar.wire import Audio, ProtocolError, decode_client, decode_server, encode

MOST_S, MOST_MB = 10, 1_000
SPLICES = (b"", b"nan", b"-1", b"1e400", b"99999999999", b"\xff" * 8, b"[" * 600, b"{", b"../x", b"\0")


def bvh(path: Path) -> None:
    turns = np.tile(np.float32([1, 0, 0, 0]), (4, HUMANOID.joints, 1))
    write_bvh(path, HUMANOID, turns, np.zeros((4, 3), np.float32), 30)


def npz(path: Path) -> None:
    turns = np.tile(np.float32([1, 0, 0, 0]), (4, HUMANOID.joints, 1))
    write_npz(path, Motion(HUMANOID, turns, np.zeros((4, 3), np.float32), 30.0))


def wire(path: Path) -> None:
    path.write_bytes(encode(Audio(seg=1, start=0, pcm=b"sound")))


def read_wire(path: Path) -> None:
    for decode in (decode_client, decode_server):
        with contextlib.suppress(ProtocolError):
            decode(path.read_bytes())


def model(name: str) -> tuple["Maker", "Reader"]:
    """A file of a small trained model; what is read is the model with the spoilt file in its place."""

    def make(path: Path) -> None:
        small = MotionEncoder(MotionEncoderConfig(features=12, width=8, latent=8))
        checkpoint.save(path.parent / "model", config=small.config, weights=small.state_dict(), card={"name": "small"})
        path.write_bytes((path.parent / "model" / name).read_bytes())

    def read(path: Path) -> None:
        shutil.copy(path, path.parent / "model" / name)
        checkpoint.read_card(path.parent / "model")
        MotionEncoder.load(path.parent / "model")

    return make, read


def ogg(path: Path) -> None:
    soundfile.write(path, np.sin(np.arange(4_800) / 20), 24_000, format="OGG", subtype="VORBIS")


Maker, Reader = Callable[[Path], object], Callable[[Path], object]
READERS: dict[str, tuple[Maker, Reader]] = {
    "bvh": (bvh, read_bvh),
    "glb": (lambda path: path.write_bytes(child()), read_gltf_rig),
    "npz": (npz, read_npz),
    "wav": (lambda path: write_wav(path, np.zeros(800, np.float32)), read_audio),
    "pth": (lambda path: torch.save({"net": {"w": torch.ones(3)}}, path), lambda path: read_tensors(path, "net")),
    "ogg": (ogg, read_audio),
    "vrm": (lambda path: path.write_bytes(child()), read_rig),
    "skin": (lambda path: path.write_bytes(child()), read_skinned),
    "config": model("config.json"),
    "card": model("card.json"),
    "safetensors": model("model.safetensors"),
    "pkl": (lambda path: path.write_bytes(np.ones(3).dumps()), lambda path: read_pickled_array(path.read_bytes())),
    "wire": (wire, read_wire),
}


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    spoilt = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at, length = int(rng.integers(len(spoilt) + 1)), int(rng.integers(1, 40))
        match rng.integers(4):
            case 0:
                spoilt[at : at + length] = SPLICES[rng.integers(len(SPLICES))]
            case 1:
                spoilt[at:at] = spoilt[at : at + length] * int(rng.integers(1, 20))
            case 2:
                del spoilt[at:]
            case _ if at < len(spoilt):
                spoilt[at] ^= 1 << int(rng.integers(8))
    return bytes(spoilt)


@pytest.mark.parametrize("count", [25, pytest.param(10_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", READERS)
def test_a_spoilt_file_is_read_or_refused(tmp_path: Path, kind: str, count: int) -> None:
    make, read = READERS[kind]
    path, rng = tmp_path / f"whole.{kind}", np.random.default_rng(7)
    make(path)
    read(path)
    whole = path.read_bytes()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("a reader hangs"))
    for number in range(count):
        path.write_bytes(mutated(whole, rng))
        signal.alarm(MOST_S)
        try:
            read(path)
        except EchoAvatarError:
            pass
        except Exception as error:
            raise AssertionError(f"mutation {number} of {kind}: {type(error).__name__}: {error}") from error
        finally:
            signal.alarm(0)
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3 < MOST_MB
