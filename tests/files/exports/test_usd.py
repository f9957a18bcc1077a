"""USD read back by Pixar's own UsdSkel."""

from pathlib import Path

import numpy as np
import pytest
from tests.files.avatar.weights import bone_weights

from echoavatar.errors import DependencyError, MotionError
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.halfway import BONES, REST, with_halfway
from echoavatar.files.exports import Take
from echoavatar.files.exports import usd as room
from echoavatar.files.exports.usd import write_usd
from echoavatar.motion.kinematics import HUMANOID

pxr = pytest.importorskip("pxr")
from pxr import Tf, Usd, UsdGeom, UsdSkel  # noqa: E402


@pytest.mark.parametrize("suffix", [".usdc", ".usdz", ".usda"])
def test_usdskel_evaluates_the_motion(short: Take, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    few = Take(short.motion.cut(0, 12), short.face[:12])  # type: ignore[index]
    write_usd(path, load_character(), few)
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert (stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (11, 30)
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    assert cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(binding.GetSkeleton())
    assert query.HasBindPose()
    joints = [str(joint).rpartition("/")[2] for joint in query.GetJointOrder()]
    assert tuple(joints) == BONES
    places = few.motion.pose().positions
    for frame in (0, 7, 11):
        found = np.array([m.ExtractTranslation() for m in query.ComputeJointSkelTransforms(frame)])
        np.testing.assert_allclose(found[: HUMANOID.joints], places[frame], atol=1e-5)
    weights = query.GetAnimQuery().ComputeBlendShapeWeights(7)
    np.testing.assert_allclose(weights, few.face[7], atol=1e-6)  # type: ignore[index]


def test_skinned_points_and_shapes_are_those_of_the_character(short: Take, tmp_path: Path) -> None:
    """UsdSkel bakes the mesh; our own skinning puts its vertices at the same places."""
    path, character = tmp_path / "a.usdc", load_character()
    few = Take(short.motion.cut(0, 3), np.zeros((3, 52), np.float32))
    write_usd(path, character, few)
    stage = Usd.Stage.Open(str(path))
    cache = UsdSkel.Cache()
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/Avatar/Skeleton")))
    body = stage.GetPrimAtPath("/Avatar/Body")
    points = UsdGeom.Mesh(body).GetPointsAttr().Get()
    skinning = cache.GetSkinningQuery(body)
    assert skinning.ComputeSkinnedPoints(query.ComputeSkinningTransforms(2), points, 2)
    pose = few.motion.pose()
    turned, moved = with_halfway(pose.rotations[2], pose.positions[2])
    used = np.unique(character.triangles[character.triangles[:, 0] >= character.face.reach])
    rest = character.positions[used][:, None] - REST
    each = np.einsum("jab,vjb->vja", turned, rest) + moved
    ours = np.einsum("vj,vja->va", bone_weights(character)[used], each)
    np.testing.assert_allclose(np.array(points), ours, atol=1e-4)
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath("/Avatar/Face/jawOpen"))
    offsets = np.array(shape.GetOffsetsAttr().Get())
    moves = character.face.moves[character.face.part(character.face.names.index("jawOpen"))]
    assert np.abs(offsets).max() == pytest.approx(np.abs(moves).max(), abs=1e-6)


def test_without_usd_core_the_remedy_is_named(short: Take, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pxr", None)
    with pytest.raises(DependencyError, match=r"echoavatar\[usd\]"):
        room.write_usd(tmp_path / "a.usdc", load_character(), short)


def test_a_full_temporary_folder_is_one_error(short: Take, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def GetRootLayer(self) -> None:
            raise Tf.ErrorException("Failed to write bytes")

    monkeypatch.setattr(room, "_stage", lambda *_: Full())
    with pytest.raises(MotionError, match="USD could not write"):
        write_usd(tmp_path / "a.usda", load_character(), short)
    assert list(tmp_path.iterdir()) == []
