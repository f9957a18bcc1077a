"""Write USD (`.usda`, `.usdc`, `.usdz`): our character as UsdSkel, with skeleton, blend shapes and animation.

Needs `usd-core`, Pixar's own package: pip install 'echoavatar[usd]'.
"""

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from echoavatar.errors import DependencyError, MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.motion import align_signs
from echoavatar.whole_file import whole_file

from ..avatar.character import Character, checked_face
from ..avatar.gltf import checked
from ..avatar.halfway import BONES, PARENTS, REST, SOURCES, half
from .take import Take


def write_usd(path: Path, character: Character, take: Take) -> None:
    """Write our character with a take, which is retargeted to our rig first.

    Raises:
        DependencyError: `usd-core` is missing.
        MotionError: the file cannot be written.
    """
    try:
        from pxr import Sdf, Tf, UsdUtils
    except ModuleNotFoundError as error:
        raise DependencyError(f"USD needs {error.name}: pip install 'echoavatar[usd]'") from error
    take = take.on_humanoid()
    suffix = path.suffix.lower()
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / f"{path.stem}{'.usdc' if suffix == '.usdz' else suffix}"
        stage, ready = _stage(plain, character, take), plain
        try:
            stage.GetRootLayer().Save()
            if suffix == ".usdz":
                ready = Path(folder) / path.name
                UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(plain)), str(ready))
        except Tf.ErrorException as error:
            raise MotionError(f"cannot write {path}: USD could not write to {folder}; free space there") from error
        with whole_file(path, error=MotionError) as partial:
            shutil.copyfile(ready, partial)


def _stage(path: Path, character: Character, take: Take) -> Any:
    from pxr import Usd, UsdGeom, UsdSkel

    motion = take.motion
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(motion.fps)
    stage.SetFramesPerSecond(motion.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(motion.frames - 1)
    root = UsdSkel.Root.Define(stage, "/Avatar")
    stage.SetDefaultPrim(root.GetPrim())
    skeleton = _skeleton(stage, "/Avatar/Skeleton")
    animation = _animation(stage, "/Avatar/Animation", take, character)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    on_face = character.triangles[:, 0] < character.face.reach
    for name, triangles in (("Body", character.triangles[~on_face]), ("Face", character.triangles[on_face])):
        _mesh(stage, f"/Avatar/{name}", character, triangles, skeleton, has_shapes=name == "Face")
    return stage


def _paths() -> list[str]:
    paths: list[str] = []
    for name, parent in zip(HUMANOID.names, HUMANOID.parents, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    halfway = zip(BONES[HUMANOID.joints :], PARENTS, strict=True)
    return paths + [f"{paths[parent]}/{name}" for name, parent in halfway]


def _offsets() -> Float[np.ndarray, "b 3"]:
    """Each bone's rest offset from its parent, metres."""
    own = HUMANOID.offsets
    return np.concatenate([own, own[list(SOURCES)]])


def _skeleton(stage: Any, path: str) -> Any:
    from pxr import Gf, UsdSkel, Vt

    skeleton = UsdSkel.Skeleton.Define(stage, path)
    skeleton.CreateJointsAttr(_paths())

    def moved(places: Float[np.ndarray, "j 3"]) -> Any:
        return Vt.Matrix4dArray([Gf.Matrix4d(1).SetTranslate(Gf.Vec3d(*map(float, p))) for p in places])

    skeleton.CreateBindTransformsAttr(moved(REST))
    skeleton.CreateRestTransformsAttr(moved(_offsets()))
    return skeleton


def _animation(stage: Any, path: str, take: Take, character: Character) -> Any:
    from pxr import Gf, UsdSkel, Vt

    rotations, root = checked(take.motion.rotations, take.motion.root)
    turns = align_signs(np.concatenate([rotations, half(rotations[:, list(SOURCES)])], 1))
    animation = UsdSkel.Animation.Define(stage, path)
    animation.CreateJointsAttr(_paths())
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * len(BONES)))
    places, spins = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    offsets = _offsets()
    for frame, (turn, place) in enumerate(zip(turns.tolist(), root, strict=True)):
        offsets[0] = place
        places.Set(Vt.Vec3fArray.FromNumpy(offsets.astype(np.float32)), frame)
        spins.Set(Vt.QuatfArray([Gf.Quatf(*q) for q in turn]), frame)
    if take.face is not None:
        animation.CreateBlendShapesAttr(list(character.face.names))
        weights = animation.CreateBlendShapeWeightsAttr()
        for frame, curves in enumerate(checked_face(take.face, len(root))):
            weights.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(curves)), frame)
    return animation


def _mesh(
    stage: Any, path: str, character: Character, triangles: Int[np.ndarray, "f 3"], skeleton: Any, *, has_shapes: bool
) -> None:
    from pxr import UsdGeom, UsdSkel, Vt

    used, local = np.unique(triangles, return_inverse=True)
    mesh = UsdGeom.Mesh.Define(stage, path)
    positions = character.positions[used].astype(np.float32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(positions))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(triangles), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(local.reshape(-1).astype(np.int32)))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(character.normals[used].astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr([tuple(map(float, positions.min(0))), tuple(map(float, positions.max(0)))])
    linear = (character.flat_colours()[used] ** 2.2).astype(np.float32)
    colour = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    colour.Set(Vt.Vec3fArray.FromNumpy(linear))
    weights = character.weights[used].astype(np.float32)
    joints = np.where(weights > 0, character.joints[used], 0).astype(np.int32)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(False, joints.shape[1]).Set(Vt.IntArray.FromNumpy(joints.reshape(-1)))
    binding.CreateJointWeightsPrimvar(False, joints.shape[1]).Set(Vt.FloatArray.FromNumpy(weights.reshape(-1)))
    if has_shapes:
        _shapes(stage, path, character, used, binding)


def _shapes(stage: Any, path: str, character: Character, used: Int[np.ndarray, " v"], binding: Any) -> None:
    """One BlendShape prim per shape, with only the points that it moves."""
    from pxr import UsdSkel, Vt

    paths = []
    for name, at, moves, turns in character.face.on(used):
        shape = UsdSkel.BlendShape.Define(stage, f"{path}/{name}")
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(moves.astype(np.float32)))
        shape.CreateNormalOffsetsAttr(Vt.Vec3fArray.FromNumpy(turns.astype(np.float32)))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(at.astype(np.int32)))
        paths.append(shape.GetPath())
    binding.CreateBlendShapesAttr(list(character.face.names))
    binding.CreateBlendShapeTargetsRel().SetTargets(paths)
