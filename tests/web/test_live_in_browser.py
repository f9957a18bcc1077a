"""The page in a real browser against the real server with the default bundle: the first minute, as a visitor has it."""

import numpy as np
import pytest
from tests.web.make_vrm import make_vrm

pytestmark = [pytest.mark.browser, pytest.mark.slow]
PATIENCE = 120  # seconds; the machine that runs this may be busy
POSE = "[...__echo.session.player.pose.rotations]"


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    return tmp_path_factory.mktemp("shots")


@pytest.fixture
def page(new_page, live_url):
    driver = new_page(480, 420)
    driver.open(f"{live_url}?quality=low")
    driver.drop("boxes.vrm", make_vrm())
    driver.wait("!!__echo.avatar.driver.vrm")
    yield driver
    assert driver.problems == []


def moves(page, degrees):
    """Waits until some joint is that far from where it was."""
    before = np.array(page.ask(POSE)).reshape(-1, 4)
    for _ in range(PATIENCE * 4):
        now = np.array(page.ask(POSE)).reshape(-1, 4)
        dots = np.clip(np.abs((before * now).sum(1)), 0, 1)
        if np.degrees(2 * np.arccos(dots)).max() > degrees:
            return True
        page.page.wait_for_timeout(250)
    return False


def test_the_first_minute(page, shots):
    assert moves(page, 0.5), "idle life"
    page.click("#begin")
    page.wait("__echo.shown.state === 'speaking' && __echo.sources.output.level > 0.02", PATIENCE)
    assert moves(page, 10)
    page.shot(shots / "speech.png")
    page.click("#stop")
    page.wait("__echo.session.player.played.epoch >= 1", PATIENCE)
    page.wait("__echo.shown.state !== 'speaking' && !__echo.shown.held", PATIENCE)
    page.click("[data-source=music]")
    if page.ask("__echo.session.ready.tracks.length > 1"):
        page.click("#menu button")
    page.wait("__echo.shown.state === 'dancing' && __echo.sources.output.level > 0.02", PATIENCE)
    assert moves(page, 20)
    page.shot(shots / "music.png")
    page.click("#stop")
    page.wait("__echo.shown.state !== 'dancing'", PATIENCE)


def test_every_action_is_acknowledged(page, shots):
    names = page.ask("__echo.session.ready.actions")
    if not names:
        pytest.skip("the default bundle has no actions yet")
    page.click(f"[data-action='{names[0]}']")
    page.wait(f"document.querySelector(`[data-action='{names[0]}']`).dataset.status === 'started'", PATIENCE)
    page.wait("document.getElementById('subtitle').textContent !== ''", PATIENCE)
    page.shot(shots / "action.png")
    page.wait(f"document.querySelector(`[data-action='{names[0]}']`).dataset.status === undefined", PATIENCE)


def test_a_broken_line_resumes_the_same_session(page):
    page.click("#begin")
    page.wait("__echo.shown.state === 'speaking'", PATIENCE)
    name, at = page.ask("[__echo.session.ready.session, __echo.metrics.at]")
    page.page.evaluate("__echo.session.connection.socket.close()")
    page.wait("__echo.session.ready.resumed", PATIENCE)
    page.wait(f"__echo.metrics.at > {at} + 48000", PATIENCE)
    assert page.ask("__echo.session.ready.session") == name
    assert page.ask("__echo.shown.state") == "speaking"
