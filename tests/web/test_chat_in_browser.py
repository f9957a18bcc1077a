"""Chat with the avatar in a real browser: typed, by microphone, and with interruptions."""

import pytest
from tests.web.make_vrm import make_vrm

from echoavatar.server.voice import find_voice

pytestmark = [pytest.mark.browser, pytest.mark.skipif(not find_voice(), reason="this machine has no voice")]
MESSAGES = "[...document.querySelectorAll('#messages p')].map((row) => row.className + ': ' + row.textContent)"


@pytest.fixture
def page(new_tab, mock_url):
    driver = new_tab(480, 420)
    driver.open(f"{mock_url}?quality=low")
    driver.drop("boxes.vrm", make_vrm())
    driver.wait("!!__echo.avatar.driver.vrm")
    driver.wait("!document.querySelector('[data-source=chat]').hidden")
    driver.click("[data-source=chat]")
    yield driver
    assert driver.problems == []


def say(page, text):
    page.write("#words", text)


def test_what_is_typed_is_answered_aloud_and_may_be_cut_across(page, tmp_path):
    page.need_sound()
    say(page, "hello there")
    page.wait("document.querySelectorAll('#messages p').length === 2")
    page.wait("__echo.shown.state === 'speaking'")
    page.wait("__echo.sources.output.level > 0.01")
    say(page, "and what else")
    page.wait("__echo.session.player.played.epoch >= 1")
    page.wait("document.querySelectorAll('#messages p').length === 4")
    assert page.ask(MESSAGES) == [
        "user: hello there",
        "assistant: You said hello there, and I have heard 0 sayings before it.",
        "user: and what else",
        "assistant: You said and what else, and I have heard 2 sayings before it.",
    ]
    page.wait("__echo.shown.state === 'speaking'")
    page.shot(tmp_path / "chat.png")


def test_what_is_said_aloud_is_answered(page):
    """Chromium's fake microphone beeps once a second: half a second of sound, then silence."""
    page.need_sound()
    page.click("#microphone")
    page.wait("document.getElementById('microphone').getAttribute('aria-pressed') === 'true'")
    page.wait("document.querySelectorAll('#messages p.assistant').length > 0")
    assert page.ask(MESSAGES)[0] == "user: something aloud"
    page.click("#microphone")
    page.wait("document.getElementById('microphone').getAttribute('aria-pressed') === 'false'")
