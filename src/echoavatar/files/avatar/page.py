"""One self-contained HTML file that plays the avatar with its sound, without a network or a server."""

import base64
import html
import json
import re
from collections.abc import Sequence
from importlib.resources import files
from typing import NamedTuple

from echoavatar.errors import MotionError


class PageClip(NamedTuple):
    """One entry of the page: a title, the name of an animation in the GLB, its sound as an Ogg file, and a note."""

    title: str
    animation: str
    audio: bytes
    note: str = ""


def page_text(glb: bytes, clips: Sequence[PageClip], *, title: str = "EchoAvatar", note: str = "") -> str:
    """The page's HTML. All clips share the mesh in `glb`. Raises MotionError: a clip's animation is not in `glb`."""
    assets = files("echoavatar") / "assets"
    data = {"glb": base64.b64encode(glb).decode(), "clips": [_entry(clip, glb) for clip in clips]}
    filled = {
        "@TITLE@": html.escape(title),
        "@NOTE@": html.escape(note),
        "@DATA@": json.dumps(data).replace("<", "\\u003c"),
        "@THREE@": (assets / "shared" / "three.js").read_text("utf-8").replace("</script", "<\\/script"),
        "@VIEWER@": (assets / "viewer.js").read_text("utf-8").replace("</script", "<\\/script"),
    }
    return re.sub("@[A-Z]+@", lambda mark: filled[mark[0]], (assets / "page.html").read_text("utf-8"))


def _entry(clip: PageClip, glb: bytes) -> dict[str, str]:
    if json.dumps(clip.animation).encode() not in glb:
        raise MotionError(
            f"clip {clip.title!r} names the animation {clip.animation!r}, which is not in the GLB; name one that is"
        )
    sound = f"data:audio/ogg;base64,{base64.b64encode(clip.audio).decode()}"
    return {"title": clip.title, "animation": clip.animation, "audio": sound, "note": clip.note}
