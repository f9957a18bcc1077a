"""Options, and words for them, that several commands share."""

import argparse
import math
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

TOKEN = "ECHOAVATAR_TOKEN"
LARGEST_SEED = 1 << 62
VIEWS = ("front", "left", "right", "back", "bust", "face")
RENDERER_NAMES = ("cpu", "gpu")
RENDERER_HELP = "what draws: cpu (default), or gpu, a graphics card (extra gpu)"
DEVICE_HELP = "processor for the models: cpu, cuda, cuda:1, or auto for a GPU if there is one (default: cpu)"
RUNTIME_HELP = (
    "how the models run: paper (bare decoding, the paper's cylinder for hands, files at 60 fps), default (the bundle's"
    " settings), bare (no cylinder, 30 fps), or additions to keep on top of paper, such as ground,feet"
)
WITHOUT_HELP = "leave out a stage: face, smoother, stillness, ground, leash, feet or hands; may be repeated"
FORMATS = ".bvh, .glb, .vrma, .usda, .usdc, .usdz, .fbx, .npz, .csv, .mp4, .webm; .vrm with --rig"
RIG_HELP = "retarget the motion to this character or skeleton: .vrm, .glb, .gltf or .bvh"
MAP_HELP = (
    "JSON that names the joints of bones that are not found; `echoavatar rig RIG --template` writes one to complete"
)


def add_model(parser: argparse.ArgumentParser, what: str = "bundle name or folder") -> None:
    """Declare `--model`."""
    parser.add_argument("--model", default="default", help=f"{what} (default: %(default)s)")


def add_repeated(parser: argparse.ArgumentParser, option: str, metavar: str, what: str) -> None:
    """Declare an option that may be given several times."""
    parser.add_argument(option, action="append", default=[], metavar=metavar, help=f"{what}; repeat for more")


def add_pipeline(parser: argparse.ArgumentParser) -> None:
    """Declare `--model`, and how its bundle runs."""
    add_model(parser)
    parser.add_argument("--device", default="cpu", help=DEVICE_HELP)
    parser.add_argument("--without", action="append", default=[], metavar="STAGE", help=WITHOUT_HELP)
    parser.add_argument("--runtime", default="default", metavar="HOW", help=RUNTIME_HELP)


def add_server(parser: argparse.ArgumentParser) -> None:
    """Declare `--server` and `--token` of a client."""
    parser.add_argument(
        "--server", default="http://127.0.0.1:8765", metavar="URL", help="the avatar's server (default: %(default)s)"
    )
    parser.add_argument("--token", default="", help=f"the server's token; default ${TOKEN}")


def choose_token(given: str | None, host: str) -> tuple[str, bool]:
    """The token that clients of a server on `host` must send, and whether it was made up here.

    On this machine alone a server needs none; other machines always need one.
    """
    from echoavatar.wire.guard import is_loopback

    is_made_up = not given and not is_loopback(host)
    return (secrets.token_urlsafe(16) if is_made_up else given or ""), is_made_up


def add_picture(parser: argparse.ArgumentParser) -> None:
    """Declare the character, the background and the renderer of a film."""
    parser.add_argument("--character", default="", metavar="NAME", help="maya (default), theo, amara or theo/Flannel")
    parser.add_argument(
        "--background",
        default="studio",
        metavar="WHAT",
        help="behind the character: studio (default), dusk, plain, or a colour such as #00ff00",
    )
    parser.add_argument("--renderer", choices=RENDERER_NAMES, default=RENDERER_NAMES[0], help=RENDERER_HELP)


def add_manner(parser: argparse.ArgumentParser) -> None:
    """Declare `--liveliness`, `--handedness`, `--eye-contact` and `--feeling`."""
    parser.add_argument(
        "--liveliness", type=_share, metavar="0..1", help="0: hardly a gesture, 1: a storyteller (default: by the seed)"
    )
    parser.add_argument(
        "--handedness", type=_share, metavar="0..1", help="leading hand, 0: left, 1: right (default: by the seed)"
    )
    parser.add_argument(
        "--eye-contact",
        type=_share,
        default=0.5,
        metavar="0..1",
        help="how long a speaker's eyes meet the viewer (default: 0.5 of the time; more while listening)",
    )
    parser.add_argument(
        "--feeling", type=_share, default=0.8, metavar="0..1", help="the voice's feeling on the face (default: 0.8)"
    )


def between(low: float, high: float, what: str) -> Callable[[str], float]:
    """A type for numbers from `low` to `high`; `what` names such a number in complaints."""

    def read(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not {what} from {low:g} to {high:g}")
        return number

    return read


_share = between(0, 1, "a number")


def local_path(text: str) -> Path:
    """A path; raises ArgumentTypeError for an address such as https://...."""
    if "://" in text:
        raise argparse.ArgumentTypeError(f"{text} is an address; download it first, then name the file")
    return Path(text)


def count(text: str) -> int:
    """How many there are of something, 1 or more."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 on")
    return int(text)


def seed(text: str) -> int:
    """A seed that all generators of random numbers take."""
    try:
        number = int(text)
    except ValueError:
        number = -1
    if not 0 <= number < LARGEST_SEED:
        raise argparse.ArgumentTypeError(f"a seed is a number from 0 to {LARGEST_SEED - 1}")
    return number


def size(text: str) -> tuple[int, int]:
    """Width and height of a picture in pixels, written as 1280x720, or the name of a shape."""
    from echoavatar.files.avatar.framing import SIZES

    if text in SIZES:
        return SIZES[text]
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size; write it as 1280x720, or {', '.join(SIZES)}")
    sides = int(width), int(height)
    if any(side % 2 or not 16 <= side <= 4096 for side in sides):
        raise argparse.ArgumentTypeError(f"{text}: width and height are even, 16 to 4096")
    return sides


@contextmanager
def progress(*, is_hidden: bool = False, **look: Any) -> Iterator[Callable[..., None]]:
    """A bar on standard error if that is a terminal; yields a function of the amount done and, if known, the total."""
    from tqdm import tqdm

    with tqdm(disable=is_hidden or None, **look) as bar:

        def show(done: float, total: float | None = None) -> None:
            bar.total = total or bar.total
            bar.update(done - bar.n)

        yield show
