"""`echoavatar animate`: turn an audio file into full-body motion, through the streaming engine."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from echoavatar.errors import EchoAvatarError

from .serve import DEVICE_HELP, WITHOUT_HELP

if TYPE_CHECKING:
    from echoavatar.files.exports import Take

FORMATS = ".bvh, .glb, .vrma, .usda, .usdc, .usdz, .fbx, .npz, .csv, .mp4; .vrm with --rig"
RIG_HELP = "retarget the motion to this character or skeleton: .vrm, .glb or .bvh"
EXAMPLES = """examples:
  echoavatar animate talk.wav -o talk.glb            the character with the animation, for any 3D program
  echoavatar animate song.mp3 -o song.mp4 --seed 7   the character filmed, with the sound
  echoavatar animate talk.wav -o talk.mp4 --close-up the face alone, to judge lips and eyes
  echoavatar animate talk.wav -o talk.bvh --fps 60   skeleton and rotations, interpolated to 60 fps
  echoavatar animate talk.wav -o talk.csv            rotations as a table, and the face as talk.face.csv
  echoavatar animate talk.wav -o talk.vrma           for any VRM avatar
  echoavatar animate talk.wav -o out.glb --rig me.vrm   your own character with the animation

The output's suffix chooses the format. Three longer endings are special: .face.csv is the face alone, in the format of
Live Link Face; .face47.csv is the face in the 47 channels of the paper authors' demo; .smplx.npz is SMPL-X data in
the format of BEAT2. BVH cannot store a face. FBX is written by your Blender; USD needs usd-core. The input may be
anything that FFmpeg reads, at any rate and with any number of channels. More: docs/integrations/exports.md
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.add_argument("audio", type=Path, metavar="AUDIO", help="sound file: wav, mp3, ogg, flac, m4a, mp4, ...")
    parser.add_argument("-o", "--output", type=Path, required=True, help=f"where to write; {FORMATS}")
    parser.add_argument("--model", default="default", help="bundle name or folder (default: %(default)s)")
    parser.add_argument("--device", default="cpu", help=DEVICE_HELP)
    parser.add_argument("--seed", type=int, default=0, help="same seed, same motion (default: %(default)s)")
    parser.add_argument("--fps", type=int, choices=(30, 60), default=30, help="frame rate (default: %(default)s)")
    parser.add_argument("--in-place", action="store_true", help="stay in one spot: remove the root's travel")
    parser.add_argument("--rig", type=Path, metavar="FILE", help=RIG_HELP)
    parser.add_argument("--upper-body", action="store_true", help="keep everything below the hips still")
    parser.add_argument("--close-up", action="store_true", help="film only the face (.mp4)")
    parser.add_argument("--without", action="append", default=[], metavar="STAGE", help=WITHOUT_HELP)


def run(args: argparse.Namespace) -> int:
    """Animate the sound, write the motion, print the real-time factor."""
    from echoavatar.files.exports import Take, read_rig, writer

    write = writer(args.output, has_rig=args.rig is not None)
    rig = None if args.rig is None else read_rig(args.rig)
    from echoavatar.engine import animate
    from echoavatar.engine.pipeline import Pipeline, load_bundle
    from echoavatar.models.audio import stream_audio
    from echoavatar.motion.stages.modes import MotionOptions

    if args.in_place and "leash" in args.without:
        raise EchoAvatarError(
            "--in-place needs the stage `leash`, which --without leash leaves out; drop one of the two"
        )
    pipeline = Pipeline(load_bundle(args.model).without(args.without), device=args.device)
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
    motion, take = done.motion, Take(done.motion, done.face, done.audio)
    if args.output.suffix.lower() == ".mp4":
        _film(args.output, take, is_close=args.close_up)
    else:
        write(args.output, take if rig is None else rig.retarget(take), rig)
    print(
        f"{args.output}: {motion.frames} frames at {args.fps} fps, {motion.seconds:.2f} s; "
        f"real-time factor {done.real_time_factor:.2f}"
    )
    return 0


def _film(path: Path, take: "Take", *, is_close: bool) -> None:
    from echoavatar.files.avatar.video import write_mp4

    audio = np.zeros(0, np.float32) if take.audio is None else take.audio

    with tqdm(total=take.motion.frames, unit="frame", desc="filming", disable=_is_quiet()) as bar:
        write_mp4(
            path,
            take.motion,
            audio,
            face=take.face,
            is_close=is_close,
            size=(720, 720) if is_close else (1280, 720),
            progress=lambda made, _: _advance(bar, made),
        )


def _advance(bar: "tqdm[object]", to: float) -> None:
    bar.update(to - bar.n)


def _is_quiet() -> bool:
    return not sys.stderr.isatty()
