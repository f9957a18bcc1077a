"""`echoavatar animate`: an audio file becomes full-body motion, through the streaming engine."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import EchoAvatarError

FORMATS = (".bvh", ".glb", ".npz", ".csv", ".mp4")
EXAMPLES = """examples:
  echoavatar animate talk.wav -o talk.glb            the character with the animation, for any 3D program
  echoavatar animate song.mp3 -o song.mp4 --seed 7   the character filmed, with the sound
  echoavatar animate talk.wav -o talk.bvh --fps 60   skeleton and rotations, interpolated to 60 fps

The format is that of the output's suffix. Input may be anything FFmpeg reads, at any rate and channel count.
"""


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


def run(args: argparse.Namespace) -> int:
    """Read, animate, write; print the real-time factor."""
    write = _writer(args.output)
    from ..audio import stream_audio
    from ..engine import animate
    from ..pipeline import Pipeline, load_bundle

    pipeline = Pipeline(load_bundle(args.model))
    with tqdm(
        unit="s", desc="animating", bar_format="{desc}: {n:.1f} s of motion [{elapsed}]", disable=_is_quiet()
    ) as bar:
        done = animate(
            pipeline,
            stream_audio(args.audio),
            seed=args.seed,
            progress=lambda seconds: _advance(bar, seconds),
        )
    from ..kinematics.resample import resample
    from ..pipeline.modes import in_place, upper_body

    motion = done.motion
    if args.upper_body:
        motion = upper_body(motion)
    if args.in_place:
        motion = in_place(motion)
    if args.fps != motion.fps:
        motion = resample(motion, args.fps)
    write(args.output, motion, done.audio)
    print(
        f"{args.output}: {motion.frames} frames at {args.fps} fps, {motion.seconds:.2f} s; "
        f"real-time factor {done.real_time_factor:.2f}"
    )
    return 0


def _writer(output: Path) -> Callable[..., None]:
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
    if suffix == ".mp4":
        from ..avatar.render import Renderer

        Renderer(64, 64)  # complains at once when numba is missing
    return {".bvh": _bvh, ".glb": _glb, ".npz": _npz, ".csv": _csv, ".mp4": _mp4}[suffix]


def _bvh(path: Path, motion, audio: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    from ..kinematics import write_bvh

    del audio
    write_bvh(path, motion.skeleton, motion.rotations, motion.root, motion.fps)


def _glb(path: Path, motion, audio: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    from ..avatar import load_character
    from ..avatar.gltf import write_glb

    del audio
    write_glb(path, load_character(), motion.rotations, motion.root, fps=motion.fps)


def _npz(path: Path, motion, audio: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    from ..kinematics.tables import write_npz

    del audio
    write_npz(path, motion)


def _csv(path: Path, motion, audio: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    from ..kinematics.tables import write_csv

    del audio
    write_csv(path, motion)


def _mp4(path: Path, motion, audio: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    from ..avatar.video import write_mp4

    with tqdm(total=motion.frames, unit="frame", desc="filming", disable=_is_quiet()) as bar:
        write_mp4(path, motion, audio, progress=lambda made, _: _advance(bar, made))


def _advance(bar: "tqdm[object]", to: float) -> None:
    bar.update(to - bar.n)


def _is_quiet() -> bool:
    return not sys.stderr.isatty()
