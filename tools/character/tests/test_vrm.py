import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.halfway import BONES
from echoavatar.motion.arkit import ARKIT_NAMES, VRM_NAMES
from echoavatar.motion.formats.gltf_rig import read_gltf_rig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_character.levels import TOOLS, simplified
from echoavatar_character.vrm import CHAINS, LINKS, expressions, hair_chains, pack_vrm, with_chains

BLENDER = """
import bpy, io_scene_vrm, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
io_scene_vrm.register()
assert bpy.ops.import_scene.vrm(filepath=sys.argv[1]) == {"FINISHED"}
(rig,) = [each for each in bpy.data.objects if each.type == "ARMATURE"]
read = rig.data.vrm_addon_extension
print("READ", len(rig.data.bones), len(read.vrm1.expressions.custom), len(read.spring_bone1.springs))
"""


def test_every_curve_and_every_preset_of_vrm_is_an_expression() -> None:
    made = expressions()
    assert set(made["custom"]) == set(ARKIT_NAMES)
    assert set(made["preset"]) == {*VRM_NAMES, "neutral", "happy", "angry", "sad", "relaxed", "surprised"}
    left = {bind["index"] for bind in made["preset"]["lookLeft"]["morphTargetBinds"]}
    assert left == {ARKIT_NAMES.index("eyeLookOutLeft"), ARKIT_NAMES.index("eyeLookInRight")}
    for expression in (*made["preset"].values(), *made["custom"].values()):
        assert all(0 < bind["weight"] <= 1 for bind in expression["morphTargetBinds"])


def test_hair_hangs_on_chains_below_the_ears_and_the_rest_stays_with_the_head() -> None:
    maya = load_character("maya")
    chains = hair_chains(maya)
    assert CHAINS // 2 < len(chains) <= CHAINS
    made = with_chains(maya, chains)
    np.testing.assert_allclose(made.weights.sum(1), 1, atol=1e-5)
    swings = (made.joints >= len(BONES)) & (made.weights > 0)
    assert made.joints[swings].max() < len(BONES) + LINKS * len(chains)
    top = max(chain[0, 1] for chain in chains)
    assert maya.positions[swings.any(1), 1].max() <= top + 1e-4
    low = np.flatnonzero(swings.any(1) & (maya.positions[:, 1] < top - 0.08))
    assert len(low) > 100
    assert not (made.joints[low][made.weights[low] > 0] == HUMANOID.index("head")).any()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Maya as VRM; at level 2, where there are the tools to simplify her, because that is quicker to read."""
    maya = load_character("maya")
    path = tmp_path_factory.mktemp("vrm") / "maya.vrm"
    path.write_bytes(pack_vrm(simplified(maya, 2) if (TOOLS / "node_modules").is_dir() else maya, "maya", hangs=True))
    return path


def test_our_own_reader_finds_the_humanoid(file: Path) -> None:
    rig = read_gltf_rig(file)
    assert dict(rig.skeleton.config.vrm).keys() == set(HUMANOID.names)


def test_outfits_and_the_humanoid_stand_beside_each_other(file: Path) -> None:
    size = int.from_bytes(file.read_bytes()[12:16], "little")
    document = json.loads(file.read_bytes()[20 : 20 + size])
    assert {"VRMC_vrm", "KHR_materials_variants"} <= set(document["extensions"])
    assert set(document["extensions"]) <= set(document["extensionsUsed"])


@pytest.mark.skipif(not (TOOLS / "node_modules").is_dir(), reason="needs `npm ci` in tools/character")
def test_khronos_gltf_transform_and_three_vrm_open_the_file(file: Path) -> None:
    done = subprocess.run(["node", TOOLS / "vrm.mjs", file], capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    assert (told["errors"], told["warnings"]) == (0, 0), told["messages"]
    assert told["inspect"]["triangles"] > 5000
    assert (told["bones"], told["custom"], told["presets"]) == (52, 52, 18)
    assert told["looks"] == "VRMLookAtExpressionApplier"
    assert told["moved"] >= 8
    assert told["springs"] >= LINKS * CHAINS // 2
    assert 0.01 < told["swing"] < 0.3
    assert told["sag"] < 0.03
    assert abs(told["halfway"] - 0.8) < 1e-3  # of 1.6 rad at the elbow


@pytest.mark.slow
@pytest.mark.skipif(find_spec("io_scene_vrm") is None, reason="needs Blender: pip install bpy bpy-vrm-format")
def test_blender_opens_the_file(file: Path) -> None:
    done = subprocess.run([sys.executable, "-c", BLENDER, file], capture_output=True, text=True, check=True)
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("READ")]
    bones, custom, springs = map(int, line.split()[1:])
    assert bones >= 52 + LINKS * springs
    assert custom == 52
    assert springs > CHAINS // 2
