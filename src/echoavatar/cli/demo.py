"""`echoavatar demo`: open a page with an avatar that reacts to live sound.

With an output folder, it writes bundled speech and music as films and models, and a page that needs no server.
"""

import argparse
import webbrowser
from importlib.resources import as_file, files
from pathlib import Path

from echoavatar.errors import EchoAvatarError
from echoavatar.whole_file import make_output_folder

from . import serve
from .options import DEVICE_HELP, add_model, add_repeated, progress, seed

CLIPS = (("speech", "Speech"), ("music", "Music"))
EXAMPLES = """examples:
  echoavatar demo             serve the live page on this machine and open it; Ctrl-C stops
  echoavatar demo --sink vmc://127.0.0.1   the same, and the avatar moves in a VMC program too
  echoavatar demo -o demo     write speech.mp4, music.mp4, speech.glb, music.glb and index.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="write files there instead of serving")
    parser.add_argument(
        "--port", type=int, default=8765, help="port of the live page; 0 takes any free one (default: %(default)s)"
    )
    add_repeated(parser, "--sink", "URL", serve.SINK_HELP)
    add_model(parser)
    parser.add_argument("--device", default="cpu", help=DEVICE_HELP)
    parser.add_argument("--seed", type=seed, default=0, help="seed of the motion in the files (default: %(default)s)")
    parser.add_argument("--no-video", action="store_true", help="do not write the MP4s, which take the most time")
    parser.add_argument("--no-browser", action="store_true", help="print the address of the page without opening it")


def run(args: argparse.Namespace) -> int:
    """Serve and open the live page, or write the files and open their page."""
    return _live(args) if args.output is None else _files(args)


def _live(args: argparse.Namespace) -> int:
    parser = argparse.ArgumentParser()
    serve.add_arguments(parser)
    words = ["--model", args.model, "--port", str(args.port), "--device", args.device]
    words += [word for sink in args.sink for word in ("--sink", sink)]
    return serve.run(parser.parse_args(words if args.no_browser else [*words, "--open"]))


def _files(args: argparse.Namespace) -> int:
    from echoavatar.animation import animate
    from echoavatar.files.avatar import load_character
    from echoavatar.files.avatar.gltf import GltfAnimation, pack_glb
    from echoavatar.files.avatar.page import PageClip, page_text
    from echoavatar.whole_file import write_whole

    make_output_folder(args.output)
    clips, moving = [], []
    for name, title in CLIPS:
        bar = progress(unit="s", desc=f"{title}: animating", bar_format="{desc}: {n:.1f} s of motion [{elapsed}]")
        with as_file(files("echoavatar") / "assets" / f"{name}.ogg") as source, bar as show:
            sound = source.read_bytes()
            done = animate(source, model=args.model, seed=args.seed, device=args.device, progress=show)
        print(f"{title}: {done.seconds:.1f} s of sound")
        print(f"  real-time factor {done.real_time_factor:.2f} (below 1 is faster than real time)")
        motion = done.motion
        done.save(args.output / f"{name}.glb")
        if not args.no_video:
            with progress(unit="frame", desc="  filming") as show:
                done.save(args.output / f"{name}.mp4", size=(960, 540), progress=show)
        moving.append(GltfAnimation(name, motion.rotations, motion.root, face=done.face))
        clips.append(PageClip(title, name, sound))
    page = args.output / "index.html"
    text = page_text(pack_glb(load_character(), moving, compact=True), clips)
    write_whole(page, text, error=EchoAvatarError)
    print(f"open {page.resolve().as_uri()}")
    if not args.no_browser:
        webbrowser.open(page.resolve().as_uri())
    return 0
