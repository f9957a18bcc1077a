"""A take: motion with its face and sound, made by `animate` or read from a recording."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.limits import readable
from echoavatar.motion.arkit import ARKIT_NAMES, reorder
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.formats.kinds import BVH, GLTF, NPZ, kind_of
from echoavatar.motion.formats.tables import NPZ_ERRORS, NpzArrays, motion_of
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.motion import frame_ratio, resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.timing import SAMPLE_RATE_HZ

if TYPE_CHECKING:
    from echoavatar.motion.kinematics.rigs import JointMap


@dataclass(frozen=True)
class Take:
    """Motion on any rig, with the face and sound that belong to it. Most writers need our rig (`on_humanoid`)."""

    motion: Motion
    face: Float[np.ndarray, "t 52"] | None = None  # ARKit curves 0..1, canonical order; None without a face
    audio: Float[np.ndarray, " s"] | None = None  # 24 kHz mono

    def on_humanoid(self) -> "Take":
        """The take on our rig, retargeted where its own rig is another."""
        if self.motion.skeleton.names == HUMANOID.names:
            return self
        return Take(retarget(self.motion), self.face, self.audio)

    def at(self, fps: float) -> "Take":
        """The take at another frame rate. A frame shows what the take shows at its time."""
        motion, face = resample(self.motion, fps), self.face
        if face is not None:
            frames = np.arange(motion.frames) * float(frame_ratio(self.motion.fps, fps))
            face = np.stack([np.interp(frames, np.arange(len(face)), curve) for curve in face.T], 1).astype(np.float32)
        return Take(motion, face, self.audio)


def read_take(path: Path, given: "JointMap | None" = None, animation: str | None = None) -> Take:
    """The take in a file: an NPZ of `animate`, `say` or SMPL, or a BVH or glTF, for which `given` may map the bones.

    `animation` names one of those in a glTF (GLB, VRM, VRMA); otherwise the first is read.

    Raises:
        MotionError: the file is missing, damaged, or of another kind, or it has no such animation.
        DependencyError: what unpacks it is missing.
    """
    kind = kind_of(path)
    if kind == GLTF:
        from echoavatar.motion.formats.gltf_clip import read_gltf_clip

        return Take(read_gltf_clip(path, animation, given))
    if kind not in {BVH, NPZ}:
        raise MotionError(f"{path} is neither .npz nor .bvh nor .glb; convert it, for example to .glb in Blender")
    if animation is not None:
        raise MotionError(f"{path} holds one motion without a name: leave out the animation {animation!r}")
    if kind == BVH:
        return Take(read_bvh(path, given))
    if given is not None:
        raise MotionError(f"{path} has known bones: a map is for a BVH or a rig, so leave it out")
    from echoavatar.motion.formats.smpl import is_smpl, smpl_motion

    try:
        with readable(path, MotionError), NpzArrays(path, MotionError) as packed:
            if is_smpl(packed):
                return Take(smpl_motion(path, packed))
            if not packed.keys() & {"names", "skeleton"}:
                raise MotionError(f"{path} has {', '.join(packed)[:80]}; give `poses` of SMPL, or a file of `animate`")
            stored = dict(packed)
        motion = _recorded(path, stored) if "names" in stored else motion_of(stored)
        face = _face(stored) if "face" in stored else None
        audio = None
        if "audio" in stored and int(stored["sample_rate"]) == SAMPLE_RATE_HZ:
            if stored["audio"].dtype.kind != "f":
                raise ValueError(f"sound of type {stored['audio'].dtype}")
            audio = np.asarray(stored["audio"], np.float32)
            if audio.ndim != 1 or not np.isfinite(audio).all():
                raise ValueError(f"sound of shape {audio.shape}, or with values that are not finite")
    except NPZ_ERRORS as error:
        raise MotionError(f"{path} is no motion of `animate` or `say`, or damaged ({error}); write it again") from error
    if face is not None and len(face) != motion.frames:
        raise MotionError(f"{path}: {len(face)} frames of face beside {motion.frames} of motion; write it again")
    return Take(motion, face, audio)


def _recorded(path: Path, stored: Mapping[str, np.ndarray]) -> Motion:
    """The motion of a `client.Recording`, whose bones are known by name."""
    names = tuple(str(name) for name in stored["names"])
    if names != HUMANOID.names:
        raise MotionError(f"{path} was recorded on another rig ({', '.join(names[:3])}, ...); record it anew")
    rotations, root = (np.asarray(stored[key], np.float32) for key in ("rotations", "root"))
    return Motion(HUMANOID, rotations, root, float(stored["frame_rate"]))


def _face(stored: Mapping[str, np.ndarray]) -> Float[np.ndarray, "t 52"] | None:
    curves, names = np.asarray(stored["face"], np.float32), [str(name) for name in stored["face_names"]]
    return reorder(curves, names, ARKIT_NAMES) if curves.shape[1] else None
