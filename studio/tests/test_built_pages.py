"""The studio's built pages are complete, up to date and free of external resources."""

import hashlib
import re
from pathlib import Path

import pytest

import echoavatar_studio

WEB = Path(__file__).parents[2] / "web"
STATIC = Path(echoavatar_studio.__file__).parent / "static"
PAGES = ("index.html", "rate.html")


def test_the_built_pages_are_of_this_source():
    """`make web` was run after the last change; `web/studio/stamp.ts` makes the digest."""
    names = [
        path.relative_to(WEB).as_posix()
        for folder in ("studio/src", "packages/client/src")
        for path in (WEB / folder).rglob("*")
        if path.is_file()
    ]
    names += ["studio/index.html", "studio/rate.html", "studio/vite.config.ts", "three.mjs", "package-lock.json"]
    digest = hashlib.sha256()
    for name in sorted(names):
        digest.update(name.encode() + b"\0")
        digest.update((WEB / name).read_bytes())
    assert (STATIC / "built_from.txt").read_text().strip() == digest.hexdigest(), "run `make web`"


@pytest.mark.parametrize("page", PAGES)
def test_all_that_a_page_names_is_there_and_ours(page):
    text = (STATIC / page).read_text("utf-8")
    named = re.findall(r'(?:src|href)="([^"]+)"', text)
    assert len(named) >= 3
    for name in named:
        assert name.startswith("./assets/")
        assert name.partition("?")[0] == "./assets/three.js" or (STATIC / name).is_file()
    assert "<style" not in text
    assert not re.search(r"<script(?![^>]*\bsrc=)", text), "the content security policy forbids scripts in the page"


def test_nothing_is_left_over_from_other_builds():
    """File names contain a hash; every script and style is referenced by a page or another script."""
    texts = [path.read_text("utf-8") for path in STATIC.rglob("*") if path.suffix in (".html", ".js")]
    for path in (STATIC / "assets").iterdir():
        if path.name != "licences.txt":
            assert any(path.name in text for text in texts), f"{path.name} is named nowhere"


def test_the_pages_name_the_licences_of_what_they_contain():
    text = (STATIC / "assets/licences.txt").read_text("utf-8")
    for name in ("three ", "@pixiv/three-vrm ", "@msgpack/msgpack "):
        assert name in text
