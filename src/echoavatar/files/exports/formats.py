"""Write a take into a file; the suffix of its name chooses the format."""

import os
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from echoavatar.errors import DependencyError, EchoAvatarError, MotionError
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.formats.tables import write_csv, write_live_link, write_npz
from echoavatar.motion.kinematics.upright import OURS
from echoavatar.whole_file import write_whole

from .take import Take

if TYPE_CHECKING:
    from ..avatar import Character
    from ..avatar.video import Shot
    from .target_rig import Rig

USD = (".usda", ".usdc", ".usdz")
FILMS = (".mp4", ".webm")
FACE_CSV, FACE47_CSV, SMPLX_NPZ = ".face.csv", ".face47.csv", ".smplx.npz"  # endings that are longer than a suffix
SUFFIXES = (".bvh", ".glb", ".vrm", ".vrma", *USD, ".fbx", ".npz", ".csv", *FILMS)


def write_take(
    path: Path,
    take: Take,
    *,
    rig: "Rig | None" = None,
    character: "Character | None" = None,
    shot: "Shot | None" = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a take, retargeted to `rig` if one is given. Each format imports only what it needs.

    A film shows `rig` or `character` (default: Maya) as `shot` says; `progress` receives the frames filmed, and all.

    Raises EchoAvatarError: as `check_output`, or the take does not fit the format.
    """
    check_output(path, has_rig=rig is not None)
    if rig is not None:
        take = rig.retarget(take)
    motion, face = take.motion, take.face
    match next(ending for ending in (FACE_CSV, FACE47_CSV, SMPLX_NPZ, *SUFFIXES) if path.name.lower().endswith(ending)):
        case ".bvh":
            stand = OURS if rig is None else rig.stand
            write_bvh(path, motion.skeleton, motion.rotations, motion.root, motion.fps, stand=stand)
        case ".npz":
            write_npz(path, motion, **({} if face is None else {"face": face, "face_names": np.array(ARKIT_NAMES)}))
        case ".csv":
            write_csv(path, motion)
            if face is not None:
                write_live_link(path.with_suffix(FACE_CSV), face, motion.fps)
        case ".face.csv":
            write_live_link(path, _face(path, take), motion.fps)
        case ".face47.csv":
            for entry in entry_points(group="echoavatar.exports", name=FACE47_CSV):
                entry.load()(path, _face(path, take), motion.fps)
                return
            raise DependencyError(
                f"{path.name!r} is written by echoavatar-lab; in a clone of the repository: pip install ./lab"
            )
        case ".smplx.npz":
            from .smplx import write_smplx

            write_smplx(path, take)
        case ".glb" | ".vrm":
            write_whole(path, _packed(path, take, rig), error=MotionError)
        case ".fbx":
            from .blender import write_fbx

            write_fbx(path, _packed(path, take, rig), motion.fps)
        case ".vrma":
            from echoavatar.motion.formats.gltf_data import refusing_damage

            from .vrma import pack_vrma

            with refusing_damage(path if rig is None else rig.path):
                data = pack_vrma(take if rig else take.on_humanoid(), rig.gltf.document if rig and rig.gltf else None)
            write_whole(path, data, error=MotionError)
        case ".mp4" | ".webm":
            from ..avatar.video import write_film

            audio = np.zeros(0, np.float32) if take.audio is None else take.audio
            if rig is not None:
                from .rig_character import film_character

                character, face = film_character(rig, face, motion.frames)
            else:
                motion = take.on_humanoid().motion
            write_film(path, motion, audio, face=face, character=character, shot=shot, progress=progress)
        case _:
            from ..avatar import load_character
            from .usd import write_usd

            write_usd(path, load_character(), take)


def check_output(output: Path, *, has_rig: bool) -> None:
    """Refuse a file that cannot be written, before any work is done.

    Raises:
        EchoAvatarError: the suffix is unknown, `--rig` does not fit the format, or the file cannot be written there.
        DependencyError: the format needs a program that is missing.
    """
    suffix = output.suffix.lower()
    if suffix not in SUFFIXES:
        raise EchoAvatarError(f"cannot write {output.name!r}: use one of {', '.join(SUFFIXES)}")
    if not output.parent.is_dir():
        raise EchoAvatarError(f"cannot write {output}: {output.parent} is not a folder; make it first")
    if not os.access(output.parent, os.W_OK) or output.is_dir():
        raise EchoAvatarError(f"cannot write {output}: no permission or a folder of that name; choose another -o")
    if has_rig and output.name.lower().endswith((FACE_CSV, FACE47_CSV, SMPLX_NPZ, *USD)):
        raise EchoAvatarError(f"cannot write {output.name!r} with --rig: leave --rig out, or write .glb")
    if suffix == ".vrm" and not has_rig:
        raise EchoAvatarError("a .vrm is written into your own character: name it with --rig, or write .glb or .vrma")
    if suffix == ".fbx":
        from .blender import find_blender

        find_blender()


def _packed(path: Path, take: Take, rig: "Rig | None") -> bytes:
    """The bytes of a GLB: the user's character where a rig is given, else ours."""
    if rig is not None:
        from .target_rig import pack_on_rig

        if rig.gltf is None:
            raise MotionError(f"{rig.path} has no mesh for {path.name!r}: write .bvh, or give a .glb as --rig")
        return pack_on_rig(rig.gltf, take)
    from ..avatar import load_character
    from ..avatar.gltf import GltfAnimation, pack_glb

    take = take.on_humanoid()
    motion = take.motion
    animation = GltfAnimation("motion", motion.rotations, motion.root, motion.fps, take.face)
    return pack_glb(load_character(), [animation])


def _face(path: Path, take: Take) -> np.ndarray:
    if take.face is None:
        raise EchoAvatarError(f"cannot write {path.name!r}: the motion has no face; use a bundle with a face model")
    return take.face
