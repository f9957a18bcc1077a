"""`echoavatar animate`: an audio file becomes full-body motion, through the streaming engine."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from ..errors import EchoAvatarError

if TYPE_CHECKING:
    from ..kinematics import Motion

FORMATS = (".bvh", ".glb", ".npz", ".csv", ".mp4")
FACE_CSV = ".face.csv"
FACE47_CSV = ".face47.csv"
EXAMPLES = """examples:
  echoavatar animate talk.wav -o talk.glb            the character with the animation, for any 3D program
  echoavatar animate song.mp3 -o song.mp4 --seed 7   the character filmed, with the sound
  echoavatar animate talk.wav -o talk.mp4 --close-up the face alone, to judge lips and eyes
  echoavatar animate talk.wav -o talk.bvh --fps 60   skeleton and rotations, interpolated to 60 fps
  echoavatar animate talk.wav -o talk.csv            rotations as a table, and the face as talk.face.csv

The format is that of the output's suffix. A name that ends in .face.csv gets the face alone, as Live Link Face
writes takes, one that ends in .face47.csv the 47 channels of the paper's authors' demo; glb, mp4 and npz hold body
and face; bvh has no room for a face. Input may be anything FFmpeg reads, at any rate and channel count.
"""


class Take(NamedTuple):
    """What the writers are given: motion, the face beside it (None: a bundle without), sound, how to film it."""

    motion: "Motion"
    face: Float[np.ndarray, "t 52"] | None
    audio: Float[np.ndarray, " s"]
    is_close: bool


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "audio", type=Path, metavar="AUDIO", help="sound file: wav, mp3, ogg, flac, m4a, mp4, ..."
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, help=f"where to write; {', '.join(FORMATS)}"
    )
    parser.add_argument("--model", default="default", help="bundle name or folder (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="same seed, same motion (default: %(default)s)")
    parser.add_argument(
        "--fps", type=int, choices=(30, 60), default=30, help="frame rate (default: %(default)s)"
    )
    parser.add_argument(
        "--in-place", action="store_true", help="stay over one spot: remove the root's travel"
    )
    parser.add_argument("--upper-body", action="store_true", help="stand still from the hips down")
    parser.add_argument("--close-up", action="store_true", help="film the face alone (mp4)")


def run(args: argparse.Namespace) -> int:
    """Read, animate, write; print the real-time factor."""
    write = _writer(args.output)
    from ..audio import stream_audio
    from ..engine import animate
    from ..pipeline import Pipeline, load_bundle
    from ..pipeline.modes import MotionOptions

    pipeline = Pipeline(load_bundle(args.model))
    pipeline.warm_up()
    with tqdm(
        unit="s", desc="animating", bar_format="{desc}: {n:.1f} s of motion [{elapsed}]", disable=_is_quiet()
    ) as bar:
        done = animate(
            pipeline,
            stream_audio(args.audio),
            seed=args.seed,
            fps=args.fps,
            options=MotionOptions(in_place=args.in_place, upper_body=args.upper_body),
            progress=lambda seconds: _advance(bar, seconds),
        )
    motion = done.motion
    write(args.output, Take(motion, done.face, done.audio, args.close_up))
    print(
        f"{args.output}: {motion.frames} frames at {args.fps} fps, {motion.seconds:.2f} s; "
        f"real-time factor {done.real_time_factor:.2f}"
    )
    return 0


def _writer(output: Path) -> "Callable[[Path, Take], None]":
    """The writer for this suffix; complains before any work is done."""
    suffix = output.suffix.lower()
    if suffix not in FORMATS:
        raise EchoAvatarError(f"cannot write {output.name!r}: use one of {', '.join(FORMATS)}")
    parent = output.parent
    if not parent.is_dir():
        raise EchoAvatarError(f"cannot write {output}: {parent} is not a folder; make it first")
    if not os.access(parent, os.W_OK) or output.is_dir():
        raise EchoAvatarError(
            f"cannot write {output}: no permission or a folder of that name; choose another -o"
        )
    if output.name.lower().endswith(FACE_CSV):
        return _face_csv
    if output.name.lower().endswith(FACE47_CSV):
        return _face47_csv
    return {".bvh": _bvh, ".glb": _glb, ".npz": _npz, ".csv": _csv, ".mp4": _mp4}[suffix]


def _bvh(path: Path, take: Take) -> None:
    from ..kinematics import write_bvh

    motion = take.motion
    write_bvh(path, motion.skeleton, motion.rotations, motion.root, motion.fps)


def _glb(path: Path, take: Take) -> None:
    from ..avatar import load_character
    from ..avatar.gltf import write_glb

    motion = take.motion
    write_glb(path, load_character(), motion.rotations, motion.root, fps=motion.fps, face=take.face)


def _npz(path: Path, take: Take) -> None:
    from ..face import ARKIT_NAMES
    from ..kinematics.tables import write_npz

    if take.face is None:
        write_npz(path, take.motion)
    else:
        write_npz(path, take.motion, face=take.face, face_names=np.array(ARKIT_NAMES))


def _csv(path: Path, take: Take) -> None:
    from ..kinematics.tables import write_csv

    write_csv(path, take.motion)
    if take.face is not None:
        _face_csv(path.with_suffix(FACE_CSV), take)


def _face_csv(path: Path, take: Take) -> None:
    from ..face.export import write_live_link

    if take.face is None:
        raise EchoAvatarError(
            f"cannot write {path.name!r}: this bundle has no face model; use --model with one"
        )
    write_live_link(path, take.face, take.motion.fps)


def _face47_csv(path: Path, take: Take) -> None:
    from ..unity.frames import write_face47

    if take.face is None:
        raise EchoAvatarError(
            f"cannot write {path.name!r}: this bundle has no face model; use --model with one"
        )
    write_face47(path, take.face, take.motion.fps)


def _mp4(path: Path, take: Take) -> None:
    from ..avatar.video import write_mp4

    with tqdm(total=take.motion.frames, unit="frame", desc="filming", disable=_is_quiet()) as bar:
        write_mp4(
            path,
            take.motion,
            take.audio,
            face=take.face,
            is_close=take.is_close,
            size=(720, 720) if take.is_close else (1280, 720),
            progress=lambda made, _: _advance(bar, made),
        )


def _advance(bar: "tqdm[object]", to: float) -> None:
    bar.update(to - bar.n)


def _is_quiet() -> bool:
    return not sys.stderr.isatty()
