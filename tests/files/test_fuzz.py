"""Files with bits flipped, bytes cut out and numbers made large: each reader answers, or refuses with one error.

`findings` holds files that once ended in a traceback, a hang or a full memory; the ending says which reader. Keep the
file that a failing run names there, and mend the reader.
"""

import contextlib
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import soundfile
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.files.exports.bodies import child
from tests.motion.formats.repacked import with_meshopt

from echoavatar.errors import EchoAvatarError
from echoavatar.files.exports import read_rig
from echoavatar.models.audio.io import read_audio, write_wav
from echoavatar.motion.formats import read_bvh, write_bvh
from echoavatar.motion.formats.gltf_rig import read_gltf_rig, read_skinned
from echoavatar.motion.formats.tables import read_npz, write_npz
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.stored import read_card
from echoavatar.wire.codec import ProtocolError, decode_client, decode_server, encode
from echoavatar.wire.messages import Audio
from echoavatar_lab import checkpoint
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder, MotionEncoderConfig
from echoavatar_lab.foreign.foreign_files import read_pickled_array, read_tensors

FINDINGS = sorted((Path(__file__).parent / "findings").iterdir())
MOST_S, MOST_MB = 10, 1_000
HEAD = 16_384  # bytes in which half of the damage is done: behind them most files have rows of numbers only
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
        read_card(path.parent / "model")
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
    "meshopt": (lambda path: path.write_bytes(with_meshopt(child())), read_skinned),
    "config": model("config.json"),
    "card": model("card.json"),
    "safetensors": model("model.safetensors"),
    "pkl": (lambda path: path.write_bytes(np.ones(3).dumps()), lambda path: read_pickled_array(path.read_bytes())),
    "wire": (wire, read_wire),
}


DAMAGE = st.lists(
    st.tuples(st.integers(0, 1 << 18), st.integers(1, 40), st.integers(1, 20), st.sampled_from(SPLICES) | st.none()),
    min_size=1,
    max_size=4,
)


def damaged(data: bytes, damage: list[tuple[int, int, int, bytes | None]]) -> bytes:
    """Each entry replaces some bytes, or says them again."""
    for at, length, times, splice in damage:
        at %= len(data) + 1
        piece = data[at : at + length] * times if splice is None else splice
        data = data[:at] + piece + data[at + length :]
    return data


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    spoilt = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        span = min(len(spoilt), HEAD) if rng.integers(2) else len(spoilt)
        at, length = int(rng.integers(span + 1)), int(rng.integers(1, 40))
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
    with bounded():
        for _ in range(count):
            path.write_bytes(mutated(whole, rng))
            is_read_or_refused(path, read)


@pytest.mark.parametrize("kind", READERS)
def test_any_damage_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, kind: str) -> None:
    """The same with damage that is made as small as it can be before it is shown."""
    make, read = READERS[kind]
    path = tmp_path_factory.mktemp("damaged") / f"whole.{kind}"
    make(path)
    whole = path.read_bytes()

    @settings(max_examples=10, deadline=None)
    @given(damage=DAMAGE)
    def check(damage: list[tuple[int, int, int, bytes | None]]) -> None:
        path.write_bytes(damaged(whole, damage))
        is_read_or_refused(path, read)

    with bounded():
        check()


@pytest.mark.parametrize("found", FINDINGS, ids=lambda found: found.name)
def test_what_was_found_stays_mended(found: Path, tmp_path: Path) -> None:
    ending = found.suffix[1:]
    for kind in ("glb", "vrm", "skin") if ending == "glb" else (ending,):
        make, read = READERS[kind]
        path = tmp_path / f"whole.{kind}"
        if kind in ("config", "card", "safetensors"):
            make(path)  # the rest of the model
        shutil.copy(found, path)
        with bounded():
            is_read_or_refused(path, read)


def is_read_or_refused(path: Path, read: Reader) -> None:
    signal.alarm(MOST_S)
    try:
        read(path)
    except EchoAvatarError:
        pass
    except Exception as error:
        raise AssertionError(f"{path} ends in {type(error).__name__}: {error}; keep it in findings") from error
    finally:
        signal.alarm(0)


@contextlib.contextmanager
def bounded() -> Iterator[None]:
    """Fails where a reader hangs, or where more than a gigabyte was taken."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("a reader hangs"))
    yield
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3 < MOST_MB
