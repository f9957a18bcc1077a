"""`echoavatar animate`: turn an audio file into full-body motion, through the streaming engine."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from echoavatar.errors import EchoAvatarError

from .batch import STDIN, Batch, add_outputs, outputs, readable_sound
from .options import (
    MAP_HELP,
    RIG_HELP,
    VIEWS,
    add_manner,
    add_picture,
    add_pipeline,
    between,
    local_path,
    progress,
    seed,
    size,
)

if TYPE_CHECKING:
    from echoavatar.files.avatar import Character
    from echoavatar.files.exports import Rig

WORDS_HELP = (
    "words of the sound, some of which get a gesture: JSON of a recogniser such as Whisper, or a list of {text, start,"
    " end} in seconds; .vtt; .srt"
)
EXAMPLES = """examples:
  echoavatar animate talk.wav -o talk.glb            the character with the animation, for any 3D program
  echoavatar animate song.mp3 -o song.mp4 --seed 7   the character filmed, with the sound
  echoavatar animate talk.wav -o talk.mp4 --view face   the face alone, to judge lips and eyes
  echoavatar animate song.mp3 -o song.mp4 --size portrait --rig me.vrm   your own character, for a telephone
  echoavatar animate talk.wav -o talk.webm --alpha   the character without a background
  echoavatar animate talk.wav -o talk.bvh --fps 60   skeleton and rotations, interpolated to 60 fps
  echoavatar animate *.wav -o motion/ --format .bvh  each sound into a file of its name
  cat talk.mp3 | echoavatar animate - -o talk.glb    sound from standard input
  echoavatar animate talk.wav -o talk.csv            rotations as a table, and the face as talk.face.csv
  echoavatar animate talk.wav -o talk.vrma           for any VRM avatar
  echoavatar animate talk.wav -o out.glb --rig me.vrm   your own character with the animation

The output's suffix chooses the format. Three longer endings are special: .face.csv is the face alone, in the format of
Live Link Face; .face47.csv is the face in the 47 channels of the paper authors' demo; .smplx.npz is SMPL-X data in
the format of BEAT2. BVH cannot store a face. FBX is written by Blender or bpy; USD needs usd-core. The input may be
anything that FFmpeg reads, at any rate and with any number of channels. More: docs/integrations/exports.md
"""

_rate = between(1, 1000, "a frame rate")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("audio", type=local_path, nargs="+", metavar="AUDIO", help="wav, mp3, ...; - is standard input")
    add_outputs(parser, "sounds")
    add_pipeline(parser)
    parser.add_argument("--seed", type=seed, default=0, help="same seed, same motion (default: %(default)s)")
    parser.add_argument("--fps", type=_rate, help="frame rate, 1 to 1000 (default: 30; with --runtime paper 60)")
    parser.add_argument("--in-place", action="store_true", help="stay in one spot: remove the root's travel")
    parser.add_argument("--rig", type=local_path, metavar="FILE", help=RIG_HELP)
    parser.add_argument("--map", type=Path, metavar="FILE", help=MAP_HELP)
    parser.add_argument("--upper-body", action="store_true", help="keep everything below the hips still")
    add_manner(parser)
    parser.add_argument("--words", type=local_path, metavar="FILE", help=WORDS_HELP)
    parser.add_argument("--view", choices=VIEWS, default=VIEWS[0], help="what the film shows (default: %(default)s)")
    parser.add_argument(
        "--size", type=size, metavar="SIZE",
        help="film size: wide (1280x720, default), portrait, square (default of bust and face), or pixels: 1920x1080",
    )  # fmt: skip
    add_picture(parser)
    parser.add_argument("--alpha", action="store_true", help="a film without a background, for compositing (.webm)")


def run(args: argparse.Namespace) -> int:
    """Animate every sound, write the motion, print the real-time factor."""
    from echoavatar.animation import Animation
    from echoavatar.engine import animate
    from echoavatar.engine.pipeline import Pipeline, load_bundle
    from echoavatar.engine.words import read_words
    from echoavatar.files.exports import check_output
    from echoavatar.files.exports.formats import FILMS, SUFFIXES
    from echoavatar.models.audio import stream_audio
    from echoavatar.models.audio.files import check_sound
    from echoavatar.motion.stages.modes import MotionOptions

    others = {"rig": args.rig, "map": args.map, "words": args.words}
    places = outputs(args.audio, args.output, args.format, known=SUFFIXES, kind="sound", **others)
    for output in places:
        check_output(output, has_rig=args.rig is not None)
    if args.map is not None and args.rig is None:
        raise EchoAvatarError("--map is for a --rig; name the rig too, or leave out --map")
    if args.words is not None and len(args.audio) > 1:
        raise EchoAvatarError("--words is for one sound; animate the others by themselves")
    words = read_words(args.words) if args.words else []
    rig = None
    if args.rig is not None:
        from echoavatar.files.exports import read_rig
        from echoavatar.motion.formats.joint_map import read_map

        rig = read_rig(args.rig, read_map(args.map))
    character = _character(args, places, rig)
    if len(args.audio) == 1 and args.audio != [STDIN]:
        check_sound(args.audio[0])  # before the model is loaded
    if args.in_place and "leash" in args.without:
        raise EchoAvatarError(
            "--in-place needs the stage `leash`, which --without leash leaves out; drop one of the two"
        )
    bundle = load_bundle(args.model).running(args.runtime).without(args.without)
    pipeline = Pipeline(bundle, device=args.device)
    pipeline.warm_up()
    fps = args.fps or bundle.runtime.fps
    options = MotionOptions(
        in_place=args.in_place,
        upper_body=args.upper_body,
        liveliness=args.liveliness,
        handedness=args.handedness,
        eye_contact=args.eye_contact,
        feeling=args.feeling,
    )
    batch = Batch(len(args.audio))
    for sound, output in zip(args.audio, places, strict=True):
        with batch.each(sound, output):
            bar = progress(unit="s", desc="animating", bar_format="{desc}: {n:.1f} s of motion [{elapsed}]")
            with bar as show, readable_sound(sound) as path:
                blocks = stream_audio(path)
                done = animate(pipeline, blocks, seed=args.seed, fps=fps, options=options, words=words, progress=show)
            with progress(is_hidden=output.suffix.lower() not in FILMS, unit="frame", desc="filming") as show:
                Animation(*done).save(
                    output,
                    rig=rig,
                    size=args.size,
                    view=args.view,
                    character=character,
                    background=args.background,
                    alpha=args.alpha,
                    renderer=args.renderer,
                    progress=show,
                )
            print(
                f"{output}: {done.motion.frames} frames at {fps:g} fps, {done.motion.seconds:.2f} s; "
                f"real-time factor {done.real_time_factor:.2f}; runtime: {bundle.runtime.label}"
            )
    return batch.end()


def _character(args: argparse.Namespace, places: list[Path], rig: "Rig | None") -> "Character | None":
    """The character to film, if any; refuse impossible films before the motion is made."""
    from echoavatar.files.exports.formats import FILMS

    if args.alpha and any(output.suffix.lower() != ".webm" for output in places):
        raise EchoAvatarError("--alpha needs a format with an alpha channel; let -o end in .webm")
    if not any(output.suffix.lower() in FILMS for output in places):
        return None
    from echoavatar.files.avatar import load_character
    from echoavatar.files.avatar.avatar_renderer import RENDERERS

    character = load_character(args.character)
    if rig is not None:
        if not rig.has_mesh:
            raise EchoAvatarError(f"{rig.path} is a skeleton without a mesh to film: give a .vrm or .glb as --rig")
        if args.character:
            raise EchoAvatarError("a film shows --rig or --character; leave one of the two out")
    RENDERERS[args.renderer](8, 8, background=args.background)
    return character
