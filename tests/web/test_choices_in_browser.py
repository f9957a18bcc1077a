"""What a visitor chooses on the page: outfits, other sessions, the token; and what a slow machine gives up."""

import json
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from starlette.websockets import WebSocket
from tests.web.conftest import PageDriver, mocked
from tests.web.make_vrm import make_vrm
from tests.web.mock_server import MockSession, greeted, refused

from echoavatar.wire.messages import Error

pytestmark = pytest.mark.browser
GREEN, RED = (0.1, 0.6, 0.2, 1), (0.8, 0.1, 0.1, 1)


@pytest.fixture
def page(new_tab: Callable[..., PageDriver], mock_url: str) -> Any:
    driver = new_tab(480, 640)
    driver.open(f"{mock_url}?quality=low")
    yield driver
    assert driver.problems == []


def with_outfits(glb: bytes, *, is_vrm: bool) -> bytes:
    """The boxes with a body in two more colours; without its extension it is any other GLB."""
    length = struct.unpack("<I", glb[12:16])[0]
    document, rest = json.loads(glb[20 : 20 + length]), glb[20 + length :]
    if not is_vrm:
        del document["extensions"]["VRMC_vrm"], document["extensionsUsed"]
        for node in document["nodes"]:
            node["name"] = node["name"].removeprefix("Bone_")
    materials = document["materials"]
    first = len(materials)
    materials += [{"pbrMetallicRoughness": {"baseColorFactor": colour, "metallicFactor": 0}} for colour in (GREEN, RED)]
    mappings = [{"material": [0, first, first + 1][k], "variants": [k]} for k in range(3)]
    document["meshes"][0]["primitives"][0]["extensions"] = {"KHR_materials_variants": {"mappings": mappings}}
    names = [{"name": "Blue"}, {"name": "Green"}, {"name": "Red"}]
    document.setdefault("extensions", {})["KHR_materials_variants"] = {"variants": names}
    document.setdefault("extensionsUsed", []).append("KHR_materials_variants")
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return (
        struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + rest
    )


COLOURS = """(() => {
  const found = [];
  __echo.avatar.driver.object.traverse(({ isMesh, material }) => {
    const colour = isMesh && (material.uniforms?.tint?.value ?? material.color);
    if (colour) found.push([colour.r, colour.g, colour.b].map((part) => Math.round(10 * part) / 10));
  });
  return found;
})()"""


@pytest.mark.parametrize(("name", "is_vrm"), [("boxes.vrm", True), ("boxes.glb", False)])
def test_an_outfit_is_chosen_by_its_picture(
    new_tab: Callable[..., PageDriver], mock_url: str, name: str, is_vrm: bool
) -> None:
    page = new_tab(480, 640)
    page.open(f"{mock_url}?quality=low")
    page.click("#avatar")
    page.wait("!document.getElementById('menu').hidden")
    assert page.ask("[...document.querySelectorAll('[data-choice^=outfit]')].length") == 3  # our own avatar's
    page.drop(name, with_outfits(make_vrm(), is_vrm=is_vrm))
    page.wait("__echo.avatar.driver.outfits.names.length === 3")
    for number, colour in ((2, RED), (1, GREEN), (0, (0.45, 0.62, 0.72))):
        page.page.keyboard.press("Escape")
        page.click("#avatar")
        page.wait("[...document.querySelectorAll('#menu img')].filter((image) => image.complete).length >= 6")
        rows = page.ask(
            "[...document.querySelectorAll('[data-choice^=outfit]')].map((row) =>"
            " [row.textContent, row.getAttribute('aria-checked'), row.querySelector('img').src])"
        )
        assert [row[0] for row in rows] == ["Blue", "Green", "Red"]
        assert len({row[2] for row in rows}) == 3
        assert [row[1] for row in rows].count("true") == 1
        page.click(f"[data-choice=outfit-{number}]")
        page.wait(f"{COLOURS}.some((own) => own.join() === '{','.join(f'{round(part, 1):g}' for part in colour[:3])}')")
    assert page.problems == []


def test_other_sessions_are_watched_and_left_from_the_menu(page: PageDriver, mock_url: str) -> None:
    page.click("#avatar")
    page.wait("!document.getElementById('menu').hidden")
    watched = "[...document.querySelectorAll('[data-choice^=watch]')].map((row) => row.dataset.choice)"
    assert page.ask(watched) == ["watch-a robot"]  # not one's own
    page.follow("[data-choice='watch-a robot']")
    page.wait("!!(window.__echo && __echo.avatar.driver)")
    assert (
        page.ask("[__echo.session.options?.role ?? 'viewer', new URLSearchParams(location.search).get('watch')]")[1]
        == "a robot"
    )
    page.click("#avatar")
    page.wait("!document.getElementById('menu').hidden")
    page.follow("[data-choice=watch]")
    page.wait("!!(window.__echo && __echo.avatar.driver)")
    assert page.ask("location.search") == "?quality=low"


def test_a_token_is_asked_for_on_the_page(new_tab: Callable[..., PageDriver]) -> None:
    async def stream(socket: WebSocket) -> None:
        if (await greeted(socket)).token == "secret":
            await MockSession(socket).run()
        else:
            error = Error(code="unauthorized", message="wrong token", fatal=True, retry_after=0)
            await refused(socket, error, 4401)

    driver = new_tab(390, 780)
    with mocked(stream=stream) as url:
        driver.page.goto(f"{url}?quality=low", wait_until="commit")
        for token in ("wrong", "secret"):
            driver.wait("!!document.getElementById('gate')?.open")
            driver.write("#token", token, end="")
            driver.follow("#gate button")
        driver.wait("!!(window.__echo && __echo.shown)")
        assert driver.ask("[document.getElementById('gate').open, location.search]") == [False, "?quality=low"]


def picture(driver: PageDriver, path: Path) -> np.ndarray:
    """What the window shows, without the avatar, its rings and the page's panels; (h, w, 3)."""
    style = "header, footer, section, aside, #toasts, #silhouette { display: none !important; }"
    driver.page.evaluate(
        f"void document.head.append(Object.assign(document.createElement('style'), {{ textContent: '{style}' }}))"
    )
    driver.page.evaluate("void (__echo.avatar.driver.object.visible = __echo.viewport.echoes.mesh.visible = false)")
    driver.page.evaluate("void (__echo.viewport.light.object.visible = false)")
    time.sleep(1.5)
    driver.shot(path)
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def test_the_poster_looks_like_the_backdrop_and_a_new_light_changes_it(page: PageDriver, tmp_path: Path) -> None:
    resolution = "__echo.viewport.resolution"
    page.page.evaluate(f"void ({resolution}.picture = () => false)")
    hidden = "!__echo.viewport.backdrop.mesh.visible"
    assert not page.page.evaluate(hidden)
    shown = {}
    for light in ("studio", "dusk"):
        page.click("#look")
        page.click(f"#menu [data-choice={light}]")
        for poster in (False, True):
            page.page.evaluate(f"void ({resolution}.isPoster = {str(poster).lower()})")
            page.wait(f"({hidden}) === {str(poster).lower()}")
            shown[light, poster] = picture(page, tmp_path / "shot.png")
        assert np.abs(shown[light, True] - shown[light, False]).mean() < 2
        assert np.abs(shown[light, True] - shown[light, False]).max() < 12
        assert np.ptp(shown[light, True].mean((1, 2))) > 4  # a gradient, no plain colour
    assert np.abs(shown["dusk", True] - shown["studio", True]).mean() > 30


def test_a_steady_rate_draws_no_more_than_15_pictures_a_second(page: PageDriver) -> None:
    page.page.evaluate("Object.assign(__echo.viewport.resolution, { picture: () => false, isSteady: true })")
    page.page.evaluate(
        "(() => { const render = __echo.viewport.render.bind(__echo.viewport); window.drawn = [];"
        " __echo.viewport.render = (seconds) => (drawn.push(seconds), render(seconds)); })()"
    )
    page.wait("drawn.length > 20")
    assert min(page.ask("drawn.slice(1)")) > 1 / 15 - 0.01


def test_the_rings_wait_for_a_dancer_who_goes_home(page: PageDriver) -> None:
    """They stay while the body moves over the floor, and come to who has come to stand."""
    rings = "__echo.viewport.echoes.mesh.position"
    page.page.evaluate(f"void ({rings}.x += 2)")
    page.page.evaluate(
        "(() => { const follow = __echo.viewport.follow.bind(__echo.viewport);"
        " window.walks = 1; let far = 0; __echo.viewport.follow = (x, z, ease, seconds) =>"
        " follow(x, z + (far += walks * 0.4 * seconds), 1, seconds); })()"
    )
    x = page.ask(f"{rings}.x")
    time.sleep(3)
    assert page.ask(f"{rings}.x") == pytest.approx(x, abs=1e-3)
    page.page.evaluate("void (window.walks = 0)")
    page.wait(f"Math.abs({rings}.x - __echo.avatar.here.x) < 0.1")
