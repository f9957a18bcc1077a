"""A clip becomes an action: the motion tokenizer reads it, and its first-layer upper-body codes are kept.

Used by `echoavatar actions add`; nothing that runs live needs it.
"""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from echoavatar.engine.pipeline.actions import NAME, Action
from echoavatar.engine.pipeline.foreign_rig import RigAdapter, RigConfig
from echoavatar.errors import MotionError
from echoavatar.models.clip_tokenizer import ClipTokenizer
from echoavatar.models.tokens import UPPER
from echoavatar.motion.action_overlay import Overlay
from echoavatar.motion.kinematics import Motion, Skeleton, from_features, to_features
from echoavatar.motion.kinematics.easing import smootherstep
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import (
    axis_angle_from_quaternion,
    matrix_from_quaternion,
    quaternion_from_matrix,
)
from echoavatar.timing import CHUNK, FRAME_RATE_HZ, FRAMES_PER_MOTION_TOKEN, ChunkSize

LEAD_FRAMES = 32  # frames of the first pose before the clip, so that the tokenizer has settled
SHORTEST_S, LONGEST_S = 0.5, 20.0
TORSO = ("spine", "chest", "upperChest", "neck", "head", "leftShoulder", "rightShoulder")
EDGE = 6  # frames in which an overlay comes and goes
SMOOTH_FRAMES = 1.2  # standard deviation of the filter
SMALLEST = 0.06  # radians; smaller turns are not kept


def action_from_motion(
    tokenizer: ClipTokenizer,
    name: str,
    motion: Motion,
    *,
    chunk: ChunkSize = CHUNK,
    hold_s: tuple[float, float] | None = None,
    about: str = "",
    guides: bool | None = None,
) -> Action:
    """An action from a clip on any rig; seconds `hold_s` of it repeat while it is held (default: the middle half).

    Without `guides`, the generator is asked for the codes, unless the clip has a single code: that only means "stand".
    Raises MotionError if the clip is too short or too long, the name cannot name an action, or the tokenizer has one
    part for the whole body.
    """
    plain = _plain(name, motion)
    codes, overlay = read_clip(tokenizer, motion, chunk)
    chunks = len(codes) // chunk.tokens
    first, last = hold_s or (motion.seconds / 4, motion.seconds * 3 / 4)
    begin = min(round(first / chunk.seconds), chunks - 1)
    end = min(max(round(last / chunk.seconds), begin + 1), chunks)
    asked = len(set(codes)) > 1 if guides is None else guides
    return Action(plain, codes, (begin, end), about or plain.replace("_", " "), asked, overlay, chunk=chunk)


def set_from_motion(
    tokenizer: ClipTokenizer,
    rig: RigConfig,
    name: str,
    motion: Motion,
    *,
    chunk: ChunkSize,
    hold_s: tuple[float, float] | None = None,
    about: str = "",
) -> Action:
    """An action as the paper has it, for a bundle on a rig of its own: a set of codes that holds as a whole.

    The clip, on any rig, is retargeted to the bundle's; the set holds the codes of its seconds `hold_s` (default: the
    middle half). It lasts as long as the clip, and has no overlay. Raises MotionError if the clip is too short or too
    long, or the name cannot name an action.
    """
    plain, skeleton = _plain(name, motion), tokenizer.skeleton
    motion = resample(retarget(motion, skeleton, has_footing=False), float(FRAME_RATE_HZ))
    lead, fill = LEAD_FRAMES, -motion.frames % FRAMES_PER_MOTION_TOKEN
    at = np.clip(np.arange(-lead, motion.frames + fill), 0, motion.frames - 1)
    whole = replace(motion, rotations=motion.rotations[at], root=motion.root[at])
    features = RigAdapter(rig, skeleton, "native").features_of(whole)
    codes = tokenizer.encode(features)[lead // FRAMES_PER_MOTION_TOKEN :, UPPER, 0]
    first, last = hold_s or (motion.seconds / 4, motion.seconds * 3 / 4)
    rate = FRAME_RATE_HZ / FRAMES_PER_MOTION_TOKEN
    begin = min(int(first * rate), len(codes) - 1)
    held = codes[begin : max(math.ceil(last * rate), begin + 1)]
    length = chunk.within(motion.seconds)
    members = tuple(sorted(set(held.tolist())))
    return Action(plain, members, (0, length), about or plain.replace("_", " "), is_set=True, chunk=chunk)


def read_clip(
    tokenizer: ClipTokenizer, motion: Motion, chunk: ChunkSize = CHUNK
) -> tuple[tuple[int, ...], Overlay | None]:
    """First-layer upper-body codes of a clip, whole chunks, and the motion of torso and head that they do not express.

    The last pose is held to fill the last chunk. Raises MotionError if the tokenizer has one part for the whole body.
    """
    skeleton = tokenizer.skeleton
    if len(tokenizer.config.parts) <= UPPER:
        raise MotionError("actions are codes of the upper body, which this tokenizer does not keep apart")
    if motion.skeleton != skeleton:
        motion = retarget(motion, skeleton)
    motion = resample(motion, float(FRAME_RATE_HZ))
    lead, fill = LEAD_FRAMES, -motion.frames % chunk.frames
    at = np.clip(np.arange(-lead, motion.frames + fill), 0, motion.frames - 1)
    rotations = matrix_from_quaternion(motion.rotations[at])
    still = rotations.copy()
    trunk = [skeleton.index(name) for name in TORSO if name in skeleton.names and "Shoulder" not in name]
    still[:, trunk] = rotations[:1, trunk]  # bowed trunks have codes of their own, which turn the arms out
    codes = tokenizer.encode(to_features(skeleton, still, motion.root[at]))
    coarse = np.full_like(codes, -1)
    coarse[:, UPPER, 0] = codes[:, UPPER, 0]
    said = from_features(skeleton, tokenizer.decode(coarse)).rotations
    turns = axis_angle_from_quaternion(quaternion_from_matrix(said.mT @ rotations))[lead:]
    first = codes[lead // FRAMES_PER_MOTION_TOKEN :, UPPER, 0]
    return tuple(first.tolist()), _overlay(skeleton, turns)


def _overlay(skeleton: Skeleton, turns: Float[np.ndarray, "t j 3"]) -> Overlay | None:
    """Smoothed turns of torso and head, from nothing to nothing; None where they are too small to see."""
    joints = [name for name in TORSO if name in skeleton.names]
    own = turns[:, [skeleton.index(name) for name in joints]]
    own = _smooth(own - np.median(own[-EDGE:], axis=0))
    edge = smootherstep(np.clip((np.arange(len(own)) + 1) / EDGE, 0, 1)).astype(np.float32)
    own = own * (edge * edge[::-1])[:, None, None]
    seen = [at for at in range(len(joints)) if np.abs(own[:, at]).max() > SMALLEST]
    if not seen:
        return None
    return Overlay(tuple(joints[at] for at in seen), own[:, seen].astype(np.float32))


def _smooth(turns: Float[np.ndarray, "t j 3"]) -> Float[np.ndarray, "t j 3"]:
    """A Gaussian filter over time, with the ends mirrored."""
    reach = round(4 * SMOOTH_FRAMES)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / SMOOTH_FRAMES) ** 2)
    padded = np.pad(turns, ((reach, reach), (0, 0), (0, 0)), "symmetric")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, len(weights), 0) @ (weights / weights.sum()))


def _plain(name: str, motion: Motion) -> str:
    """The name as the library keeps it. Raises MotionError for an impossible name or length of the clip."""
    plain = "_".join(name.lower().replace("-", " ").replace("_", " ").split())
    if not NAME.fullmatch(plain):
        raise MotionError(f"{name[:80]!r} cannot name an action; use up to 64 letters, digits and underscores")
    if not SHORTEST_S <= motion.seconds <= LONGEST_S:
        raise MotionError(
            f"a clip of {motion.seconds:.1f} s cannot be an action; cut it to {SHORTEST_S:g} to {LONGEST_S:g} s"
        )
    return plain
