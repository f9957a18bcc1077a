"""Measure what the stages behind the decoder do to generated motion.

    python scripts/measure_post.py MADE.npz SOUND...          generate (with the default bundle) and measure
    python scripts/measure_post.py MADE.npz                   measure what was generated before

Every sound is looped or cut to `SECONDS`; all sounds run in one batch. MADE.npz holds the decoded `features` (sessions,
frames, channels); the stages get them in the bundle's chunks, and once in chunks of 8 frames. For the hour on a leash
each session repeats its own features. `border_steps_over_others` is the mean
change of angular velocity at chunk borders over that at other frames; 1 means that borders do not show. Prints one line
of JSON.
"""

import json
import sys
from pathlib import Path

import numpy as np
import torch

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.models.audio.io import stream_audio
from echoavatar.motion.interpolate import StreamInterpolator
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import (
    angle_between,
    axis_angle_from_quaternion,
    length,
    matrix_from_quaternion,
    quaternion_conjugate,
    quaternion_multiply,
)
from echoavatar.motion.motion_chunk import MotionChunk, join_batches
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.motion.stages.post import SWITCHES, Post
from echoavatar.timing import CHUNK_FRAMES, FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar_lab.data.faults import penetration_depth_m, skate

SECONDS = 60.0
BALLS = list(HUMANOID.config.feet)[1::2]


def generate(sounds: list[Path]) -> np.ndarray:
    """Decoded features (b, t, c), before any other stage."""
    pipeline = Pipeline(load_bundle())
    size = pipeline.chunk.samples
    chunks = int(SECONDS * SAMPLE_RATE_HZ / size)
    audio = np.stack([np.resize(np.concatenate(list(stream_audio(path))), chunks * size) for path in sounds])
    state, active = pipeline.init_state(len(sounds)), np.ones(len(sounds), np.bool_)
    for row in range(len(sounds)):
        pipeline.reset(state, np.arange(len(sounds)) == row, seed=row)
    features = _tap(pipeline.decoder, "step")
    for step in range(chunks):
        pipeline.step(audio[:, step * size : (step + 1) * size], state, active)
    return np.concatenate(features, 1)


def _tap(stage: object, name: str) -> list[np.ndarray]:
    """Record every future return value of a method."""
    seen: list[np.ndarray] = []
    method = getattr(stage, name)

    def tapped(*arguments: object) -> np.ndarray:
        seen.append(method(*arguments).copy())
        return seen[-1]

    setattr(stage, name, tapped)
    return seen


def through(
    features: np.ndarray, stages: tuple[str, ...], options: MotionOptions, frames: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and roots of every session, in chunks of so many frames."""
    post = Post(HUMANOID, stages=stages)
    state, active = post.init_state(len(features)), np.ones(len(features), np.bool_)
    state.modes.choose(active, options)
    shown = [post.step(part, state, active) for part in in_chunks(features, frames)]
    rotations, root = join_batches(shown)
    return rotations, root


def in_chunks(features: np.ndarray, frames: int) -> list[np.ndarray]:
    """Features (b, t, c) chunk by chunk."""
    return np.split(features, range(frames, features.shape[1], frames), 1)


def measured(quaternions: np.ndarray, root: np.ndarray, frames: int) -> dict[str, float]:
    """Penetration, smoothness, foot skate and root travel over all sessions."""
    rotations = matrix_from_quaternion(quaternions)
    depth = np.concatenate([penetration_depth_m(HUMANOID, session) for session in rotations])
    places = forward_kinematics(HUMANOID, rotations, root).positions
    wrists = places[:, :, HUMANOID.indices(["leftHand", "rightHand"])]
    jerk = np.linalg.norm(np.diff(wrists, n=3, axis=1), axis=-1).mean() * FRAME_RATE_HZ**3
    standing = HUMANOID.rest_positions[BALLS, 1]
    feet = [skate(p[:, BALLS], FRAME_RATE_HZ, standing_height=standing) for p in places]
    speed = angle_between(rotations[:, 1:], rotations[:, :-1]) * FRAME_RATE_HZ
    change = np.stack([velocity_change(session) for session in quaternions])
    return {
        "frames_deeper_than_5mm": int((depth > 0.005).any(-1).sum()),
        "frames": len(depth),
        "deepest_mm": float(depth.max() * 1000),
        "wrist_jerk_m_s3": float(jerk),
        "skate_cm_s": float(np.mean(feet)),
        "farthest_m": float(np.linalg.norm((root - root[:, :1])[..., [0, 2]], axis=-1).max()),
        "border_steps_over_others": border_share(change, frames),
        "fastest_deg_s": float(np.degrees(speed.max())),
    }


def velocity_change(quaternions: np.ndarray) -> np.ndarray:
    """Mean length (t - 2) of the change of the joints' angular velocity (t, j, 4 in), around frames 1 to t - 2."""
    turns = quaternion_multiply(quaternions[1:], quaternion_conjugate(quaternions[:-1]))
    change: np.ndarray = length(np.diff(axis_angle_from_quaternion(turns), axis=0)).mean((-1, -2))
    return change


def border_share(change: np.ndarray, frames: int) -> float:
    """Mean change at the first and last frame of chunks over that at other frames; `frames` is the chunk size."""
    place = (np.arange(change.shape[-1]) + 1) % frames
    is_border = (place == 0) | (place == frames - 1)
    return float(change[..., is_border].mean() / change[..., ~is_border].mean())


def at_60(quaternions: np.ndarray, root: np.ndarray, frames: int) -> dict[str, float]:
    """`border_share` at 60 fps, and the change at source frames over that at the interpolated frames between them."""
    changes = []
    for session, places in zip(quaternions, root, strict=True):
        stream = StreamInterpolator(60)
        chunks = zip(in_chunks(session[None], frames), in_chunks(places[None], frames), strict=True)
        parts = [stream.push(MotionChunk(r[0], p[0])).rotations for r, p in chunks]
        changes.append(velocity_change(np.concatenate(parts)))
    change = np.stack(changes)
    return {
        "border_steps_over_others": border_share(change, 2 * frames),
        "source_frames_over_between": float(change[:, 1::2].mean() / change[:, ::2].mean()),
    }


def farthest(features: np.ndarray, minutes: int, options: MotionOptions, frames: int) -> float:
    """Largest distance of a root from its start, in metres, over so many minutes."""
    post, on = Post(HUMANOID), np.ones(len(features), np.bool_)
    state = post.init_state(len(features))
    state.modes.choose(on, options)
    parts, far = in_chunks(features, frames), 0.0
    for step in range(minutes * 60 * FRAME_RATE_HZ // frames):
        root = post.step(parts[step % len(parts)], state, on).root
        far = max(far, float(np.hypot(root[..., 0], root[..., 2]).max()))
    return far


def main() -> None:
    """Generate if sounds are given, then measure."""
    torch.set_num_threads(1)
    path, sounds = Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]]
    if sounds:
        np.savez(path, features=generate(sounds))
    with np.load(path) as kept:
        features = kept["features"]
    free, frames = MotionOptions(), load_bundle().chunk.frames
    without_hands = tuple(stage for stage in SWITCHES if stage != "hands")
    full = through(features, SWITCHES, free, frames)
    report: dict[str, object] = {
        "minutes": features.shape[0] * features.shape[1] / FRAME_RATE_HZ / 60,
        "frames a chunk": frames,
        "decoded": measured(*through(features, ("ground",), free, frames), frames),
        "without hands": measured(*through(features, without_hands, free, frames), frames),
        "all": measured(*full, frames),
        "all, 8 frames a chunk": measured(*through(features, SWITCHES, free, CHUNK_FRAMES), CHUNK_FRAMES),
        "at 60 fps": at_60(*full, frames),
        "an hour": farthest(features, 60, free, frames),
        "an hour on a leash of 1 m": farthest(features, 60, MotionOptions(leash_m=1), frames),
    }
    for name in ("leash_m", "in_place", "upper_body"):
        options = MotionOptions.model_validate({name: 1})
        report[name] = measured(*through(features, SWITCHES, options, frames), frames)
    print(json.dumps(report))


if __name__ == "__main__":
    main()
