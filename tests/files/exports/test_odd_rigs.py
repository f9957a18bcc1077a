"""The same pose on any rig: moved, turned, scaled, mirrored, of any rest pose and axes; as a rig and as a source."""

import logging
from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.bodies import NAMES, offsets_of
from tests.files.exports.moving import clapping
from tests.files.exports.odd import Odd, _matrix, _turn, bvh, glb
from tests.files.exports.odd_rigs import TOLERANCE, outcomes, places_in, tried
from tests.motion.formats.test_gltf_rig import spoilt
from tests.motion.kinematics import naming
from tests.motion.stages.test_modes import walking

from echoavatar.errors import MotionError
from echoavatar.files.avatar.gltf import container
from echoavatar.files.exports import Take, read_rig, write_take
from echoavatar.motion.formats.gltf_data import read_chunks
from echoavatar.motion.kinematics import HUMANOID, Skeleton
from echoavatar.motion.kinematics.retarget import retarget

SEEDS = 500
BODY = offsets_of(body=0.9, legs=1.1, arms=1.2)
SOME_AXES = np.random.default_rng(5).normal(0, 1.2, (len(NAMES), 3))


def moved(*place: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = place
    return matrix


def stretched(*scale: float) -> np.ndarray:
    return np.diag([*scale, 1.0])


Z_UP = np.pi / 2 * np.array([1.0, 0, 0])
CASES = {
    "half a metre aside": Odd(BODY, above=(moved(0.5, 0, 0),)),
    "two metres aside, one up": Odd(BODY, above=(moved(2, 1, -2),)),
    "turned by 90 degrees": Odd(BODY, above=(_matrix(np.array([0, np.pi / 2, 0]), 1.0),)),
    "turned by 60 degrees about a slanting axis": Odd(BODY, above=(_matrix(np.array([0.6, 0.6, 0.6]), 1.0),)),
    "leaning by 15 degrees, the mesh upright": Odd(BODY, above=(_matrix(np.array([0.26, 0, 0]), 1.0),), in_world=True),
    "leaning, bound in another pose": Odd(BODY, bind="A", above=(_matrix(np.array([0.26, 0, 0]), 1.0),), in_world=True),
    "stretched, the mesh as well, bound in another pose": Odd(
        BODY, pose="one up", bind="A", above=(stretched(1, 1.3, 0.8),), in_world=True
    ),
    "three nested nodes": Odd(
        BODY, above=(moved(1, 2, 3), _matrix(np.array([0.3, 1, 0]), 3.0), _matrix(np.array([0, -2, 0.2]), 0.1))
    ),
    "mirrored": Odd(BODY, above=(stretched(-1, 1, 1),)),
    "bones of an arm mirrored": Odd(BODY, pose="A", axes=SOME_AXES, mirrored_arm=True),
    "a joint above the hips": Odd(BODY, above=(moved(0, 0.3, 0),), root_joint=True),
    "stretched above the hips": Odd(BODY, above=(stretched(1, 1.3, 0.8),)),
    "Z up in centimetres, as Blender writes": Odd(BODY, above=(_matrix(-Z_UP, 0.01),), baked=100 * _turn(Z_UP)),
    "faces +X": Odd(BODY, baked=_turn([0, np.pi / 2, 0])),
    "faces between": Odd(BODY, baked=_turn([0, 0.6, 0])),
    "faces -Z": Odd(BODY, dict(zip(NAMES, map(str, range(52)), strict=True)), is_vrm=True, baked=_turn([0, np.pi, 0])),
    "joints of any axes and scales": Odd(
        BODY, axes=SOME_AXES, scales=np.exp(np.random.default_rng(6).normal(0, 0.4, len(NAMES)))
    ),
    "arms down": Odd(BODY, pose="N", axes=SOME_AXES),
    "hands turned": Odd(BODY, pose="hands"),
    "bent knees": Odd(BODY, pose="knees"),
    "one arm up": Odd(BODY, pose="one up", axes=SOME_AXES),
    "sitting": Odd(BODY, pose="sitting"),
    "in the middle of a movement, bound in A-pose": Odd(BODY, pose="any", bind="A", seed=3),
    "two skins, twist joints, hair": Odd(BODY, pose="A", skins=2, twists=True, hair=3),
    "beside another character": Odd(BODY, second=True),
}


@pytest.fixture(scope="module")
def take() -> Take:
    return Take(clapping(1.2), None, None)


@pytest.mark.parametrize("name", CASES)
def test_the_same_pose_as_on_the_plain_rig(
    name: str, take: Take, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    outcome = tried(CASES[name], take, tmp_path, ".glb")
    assert not outcome.refusal
    assert "mirrored" not in caplog.text.replace(str(tmp_path), "")  # a mirror above the hips does not swap its sides
    assert outcome.error < TOLERANCE
    assert outcome.as_source < TOLERANCE


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("degrees", [10, 45, 60, 80, 89, 90, 135, 180])
def test_a_turn_by_any_angle_above_the_hips_changes_nothing(degrees: float, axis: int, tmp_path: Path) -> None:
    path, above = tmp_path / "a.glb", _matrix(np.radians(degrees) * np.eye(3)[axis], 1.0)
    rests = []
    for odd in (Odd(BODY), Odd(BODY, above=(above,)), Odd(BODY, above=(moved(0.5, 0, 2) @ above,), in_world=True)):
        path.write_bytes(glb(odd))
        rests.append(read_rig(path).skeleton.rest_positions)
    np.testing.assert_allclose(rests[1:], rests[:1] * 2, atol=1e-3)


@pytest.mark.parametrize(
    "name", ["faces +X", "faces between", "arms down", "one arm up", "Z up in centimetres, as Blender writes"]
)
def test_the_same_pose_as_on_the_plain_bvh(name: str, take: Take, tmp_path: Path) -> None:
    outcome = tried(CASES[name], take, tmp_path, ".bvh")
    assert not outcome.refusal
    assert outcome.error < TOLERANCE
    assert outcome.as_source < TOLERANCE


@pytest.mark.parametrize("seeds", [range(6), pytest.param(range(6, SEEDS), marks=pytest.mark.slow)], ids=["few", "all"])
def test_rigs_drawn_by_chance_hold_the_pose_or_say_why_not(seeds: range, tmp_path: Path) -> None:
    """`python -m tests.files.exports.odd_rigs 500` prints a summary of the same."""
    found = [(odd, suffix, outcome) for odd, suffix, outcome in outcomes(seeds, tmp_path)]
    far = [(odd.seed, suffix) for odd, suffix, o in found if max(o.error, o.as_source) > TOLERANCE]
    refused = [outcome.refusal for _, _, outcome in found if outcome.refusal]
    assert not far
    assert len(refused) < len(found) / 20


@pytest.mark.parametrize("suffix", [".glb", ".bvh"])
def test_a_left_handed_rig_is_mirrored_and_one_line_says_so(
    suffix: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    odd, path = Odd(BODY * [-1, 1, 1]), tmp_path / f"a{suffix}"
    if suffix == ".glb":
        path.write_bytes(glb(odd))
    else:
        bvh(odd, path)
    rest = read_rig(path).skeleton.rest_positions
    assert caplog.text.count("its left side is on the right where its toes point ahead") == len(caplog.records) == 1
    path.unlink()
    if suffix == ".glb":
        path.write_bytes(glb(Odd(BODY)))
    else:
        bvh(Odd(BODY), path)
    np.testing.assert_allclose(rest, read_rig(path).skeleton.rest_positions, atol=1e-5)


def test_a_rig_that_would_shear_its_bones_is_refused(tmp_path: Path) -> None:
    def squash(document: dict) -> None:  # type: ignore[type-arg]
        next(node for node in document["nodes"] if node["name"] == "mixamorig:LeftArm")["scale"] = [1, 1.2, 1]

    path = spoilt(tmp_path / "a.glb", glb(Odd(BODY)), squash)
    with pytest.raises(MotionError, match=r"a\.glb: mixamorig:LeftArm is scaled .* apply its scale"):
        read_rig(path)


def test_a_rig_that_is_scaled_to_nothing_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(glb(Odd(BODY, above=(stretched(0, 0, 0),))))
    with pytest.raises(MotionError, match="scaled to nothing"):
        read_rig(path)


def test_it_stays_where_it_stands_in_the_file(take: Take, tmp_path: Path) -> None:
    """The place of an armature is the file's, and so is its floor."""
    soles, hips = [], []
    for name, above in (("plain", ()), ("aside", (moved(2, 1, -2),))):
        path, out = tmp_path / f"{name}.glb", tmp_path / f"{name}.out.glb"
        path.write_bytes(glb(Odd(BODY, above=above)))
        write_take(out, take, rig=read_rig(path))
        names, worlds = places_in(out)
        places = worlds[..., :3, 3]
        soles.append(places[:, [names.index(f"mixamorig:{side}ToeBase") for side in ("Left", "Right")], 1].min())
        hips.append(places[:, names.index("mixamorig:Hips")])
    np.testing.assert_allclose(hips[1] - hips[0], np.tile([2, 1, -2], (len(hips[0]), 1)), atol=1e-4)
    assert soles[0] == pytest.approx(0.02, abs=0.01)


def test_animations_and_a_second_body_are_left_out_aloud(
    take: Take, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.glb"
    first, second = glb(Odd(BODY, animated=True)), len(NAMES)

    def double(document: dict) -> None:  # type: ignore[type-arg]
        """A smaller copy, beside the first, with a skin of its own."""
        nodes = [dict(node) for node in document["nodes"][:second]]
        start = len(document["nodes"])
        for node in nodes:
            node["children"] = [child + start for child in node.get("children", [])]
        document["nodes"] += nodes
        skin = document["skins"][0]
        document["skins"].append({"joints": [joint + start for joint in skin["joints"]]})
        document["scenes"][0]["nodes"].append(start)

    spoilt(path, first, double)
    with caplog.at_level(logging.WARNING):
        write_take(tmp_path / "b.glb", take, rig=read_rig(path))
    assert "several characters" in caplog.text
    assert "1 animations are left out" in caplog.text
    document = read_chunks(tmp_path / "b.glb").document
    assert max(channel["target"]["node"] for channel in document["animations"][0]["channels"]) < second


def test_the_head_of_a_wig_is_not_the_bodys(take: Take, tmp_path: Path) -> None:
    """Both skins lie under one node, and the names of the wig's joints fit better than a Rigify body's."""
    body = naming.body(*naming.every_body()["Rigify"]).skeleton.config
    names = ["all", *body.names, "wig", "Head", "hair1"]
    count = len(body.names)
    parents = [-1, *(parent + 1 for parent in body.parents), 0, count + 1, count + 2]
    places = [(0, 0, 0), *body.offsets, (0, 1.5, 0), (0, 0.1, 0), (0, 0.1, 0)]
    nodes = [
        {"name": name, "translation": [float(x) for x in place]} for name, place in zip(names, places, strict=True)
    ]
    for node, entry in enumerate(nodes):
        if children := [child for child, parent in enumerate(parents) if parent == node]:
            entry["children"] = children
    skins = [{"joints": list(range(1, count + 1))}, {"joints": list(range(count + 1, count + 4))}]
    document = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "scene": 0, "nodes": nodes, "skins": skins}
    (tmp_path / "a.glb").write_bytes(container(document, b""))
    skeleton = read_rig(tmp_path / "a.glb").skeleton
    assert [skeleton.names[skeleton.config.vrm[bone]] for bone in ("hips", "head")] == ["DEF-spine", "DEF-spine.006"]


def test_feet_that_slide_more_than_the_sources_are_named(caplog: pytest.LogCaptureFixture) -> None:
    """A body with hardly any shins cannot keep its feet in place."""
    walk = walking(3.0)
    with caplog.at_level(logging.WARNING):
        retarget(walk, HUMANOID)
    assert "slide" not in caplog.text
    offsets = dict(zip(HUMANOID.names, HUMANOID.config.offsets, strict=True))
    for foot in ("leftFoot", "rightFoot"):
        offsets[foot] = tuple(0.2 * x for x in offsets[foot])
    config = HUMANOID.config.model_copy(update={"offsets": tuple(offsets.values())})
    with caplog.at_level(logging.WARNING):
        retarget(walk, Skeleton(config))
    assert "planted feet slide at" in caplog.text
