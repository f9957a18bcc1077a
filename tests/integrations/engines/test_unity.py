"""The Unity package, compiled by mono against declarations of Unity's classes, beside our own kinematics."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.files.exports.moving import clapping

from echoavatar.files.exports import Take
from echoavatar.files.exports.vrma import pack_vrma
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.server.sinks.encoders import Frame, JsonEncoder
from echoavatar.wire.messages import Rig

PACKAGE = Path(__file__).parents[3] / "integrations/unity"
NEWTONSOFT = sorted(Path("/usr/lib").glob("*/Newtonsoft.Json-5.0/Newtonsoft.Json.dll"))
MIRROR = np.array([-1, 1, 1])
FRAME = 37

pytestmark = pytest.mark.skipif(
    not (shutil.which("mcs") and shutil.which("mono") and NEWTONSOFT),
    reason="apt install mono-mcs mono-runtime libnewtonsoft-json5.0-cil",
)


@pytest.fixture(scope="module")
def take() -> Take:
    motion = clapping().cut(0, 60)
    return Take(motion, np.random.default_rng(0).uniform(size=(60, 52)).astype(np.float32), None)


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package and the probe as one program."""
    folder = tmp_path_factory.mktemp("unity")
    sources = [*PACKAGE.rglob("*.cs"), *Path(__file__).parent.glob("*.cs")]
    command = ["mcs", f"-out:{folder / 'probe.exe'}", f"-r:{NEWTONSOFT[0]}", *map(str, sources)]
    subprocess.run(command, check=True, capture_output=True)
    shutil.copy(NEWTONSOFT[0], folder)
    return folder / "probe.exe"


def ask(probe: Path, folder: Path, vrma: bytes, datagrams: list[str], seconds: float) -> tuple[int, str]:
    """Run the probe on a character whose bones have axes of their own and that faces somewhere."""
    draw = np.random.default_rng(1)
    rest = np.array(HUMANOID.config.offsets)
    for joint, parent in enumerate(HUMANOID.parents[1:], start=1):
        rest[joint] += rest[parent]
    bones = [
        {
            "name": name,
            "parent": None if parent < 0 else HUMANOID.names[parent],
            "place": [float(x) for x in place * MIRROR],
            "axes": Rotation.random(random_state=draw).as_quat().tolist(),
        }
        for name, parent, place in zip(HUMANOID.names, HUMANOID.parents, rest, strict=True)
    ]
    (folder / "a.vrma").write_bytes(vrma)
    facing = Rotation.from_euler("y", 40, degrees=True).as_quat().tolist()
    asked = {"vrma": str(folder / "a.vrma"), "seconds": seconds, "bones": bones, "facing": facing}
    (folder / "asked.json").write_text(json.dumps(asked | {"datagrams": datagrams}), "utf-8")
    done = subprocess.run(["mono", str(probe), str(folder / "asked.json")], capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout.strip()


def test_a_character_with_axes_of_its_own_stands_as_ours_does(probe: Path, take: Take, tmp_path: Path) -> None:
    assert take.face is not None
    motion = take.motion
    rest = tuple(tuple(float(x) for x in offset) for offset in HUMANOID.config.offsets)
    encoder = JsonEncoder(Rig(names=HUMANOID.names, parents=HUMANOID.parents, rest=rest))
    frame = Frame(at=0, seconds=0.0, root=motion.root[FRAME], rotations=motion.rotations[FRAME], face=take.face[FRAME])
    sent = [one.decode() for one in encoder(frame)]
    hostile = ["", "{", "[]", '{"type": "pose"}', '{"type": "pose", "root": [1], "rotations": [[1]]}', sent[1][:-9]]
    code, said = ask(probe, tmp_path, pack_vrma(take), [sent[1], *sent, *hostile], FRAME / 30)
    assert code == 0, said
    found = json.loads(said)
    assert found["duration"] == pytest.approx(59 / 30)
    assert found["height"] == pytest.approx(HUMANOID.config.offsets[0][1])
    turned = Rotation.from_euler("y", 40, degrees=True)
    wanted = turned.apply(np.asarray(motion.pose().positions)[FRAME] * MIRROR)
    assert found["stream"].pop("poses") == 1  # the first came before the rig, the hostile ones are left out
    for way in ("file", "stream"):
        places = np.array([found[way][name] for name in HUMANOID.names])
        np.testing.assert_allclose(places, wanted, atol=3e-4, err_msg=way)
    for k, name in enumerate(ARKIT_NAMES):
        assert found["expressions"][name] == pytest.approx(take.face[FRAME, k], abs=1e-5)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda data: data[:4000], "middle of a chunk"),
        (lambda data: b"RIFF" + data[4:], "not a glTF binary"),
        (lambda data: data.replace(b"VRMC_vrm_animation", b"XXXX_xxx_xxxxxxxxx"), "not a VRM animation"),
        (lambda data: data.replace(b'"count":60', b'"count":99'), "beyond the file"),
    ],
)
def test_a_damaged_file_says_what_is_wrong(probe: Path, take: Take, tmp_path: Path, spoil, said: str) -> None:  # type: ignore[no-untyped-def]
    data = pack_vrma(take)
    assert spoil(data) != data
    code, told = ask(probe, tmp_path, spoil(data), [], 0.0)
    assert code == 1
    assert said in told
