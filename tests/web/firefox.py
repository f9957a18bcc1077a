"""Firefox for tests of pages. It speaks WebDriver BiDi itself, so no geckodriver is needed.

`FirefoxPage` has of Playwright's page what `PageDriver` uses.
"""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

XVFB = shutil.which("Xvfb")
PULSEAUDIO = shutil.which("pulseaudio")
FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
START_S = 60.0
ANSWER_S = 120.0
PREFERENCES = {
    "webgl.force-enabled": True,  # also where WebGL runs on the processor
    "app.update.enabled": False,
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "toolkit.telemetry.reportingpolicy.firstRun": False,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
    "media.autoplay.default": 0,
    "media.navigator.streams.fake": True,
    "media.navigator.permission.disabled": True,
    "browser.download.folderList": 2,  # the folder below, without a question
    "browser.download.alwaysOpenPanel": False,
}
KEYS = {"Escape": "\ue00c", "Enter": "\ue007"}


class Firefox:
    """Firefox with a profile of its own, on the display that is there or on one in memory. Headless it has no WebGL.

    On a machine without a sound device it plays into one of PulseAudio's that nobody hears.
    """

    def __init__(self, port: int) -> None:
        if FIREFOX is None or not ("DISPLAY" in os.environ or XVFB):
            pytest.skip("no Firefox with a display on this machine: apt-get install firefox-esr xvfb")
        self._opened = ExitStack()
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self.downloads = Path(self._profile.name) / "downloads"
        self.downloads.mkdir()
        preferences = PREFERENCES | {"browser.download.dir": str(self.downloads)}
        lines = [f'user_pref("{name}", {json.dumps(value)});' for name, value in preferences.items()]
        (Path(self._profile.name) / "user.js").write_text("\n".join(lines))
        words = [FIREFOX, "--no-remote", "--profile", self._profile.name]
        is_silent = not Path("/dev/snd").exists()
        self.has_sound = not is_silent or PULSEAUDIO is not None
        sound = self._opened.enter_context(_sound_device()) if is_silent and self.has_sound else {}
        self._process = subprocess.Popen(
            [*words, "--remote-debugging-port", str(port)],
            env={**os.environ, **sound, "DISPLAY": os.environ.get("DISPLAY") or self._opened.enter_context(_display())},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._number = 0
        self._events: list[Callable[[str, dict[str, Any]], None]] = []
        try:
            self._socket = self._connected(port)
            self.ask("session.new", capabilities={})
            self.ask("session.subscribe", events=["log.entryAdded"])
        except BaseException:
            self._end()
            raise

    def _connected(self, port: int) -> ClientConnection:
        end = time.monotonic() + START_S
        while True:
            try:
                asked = connect(f"ws://127.0.0.1:{port}/session", max_size=None, compression=None, proxy=None)
                return self._opened.enter_context(asked)
            except (OSError, WebSocketException):
                assert self._process.poll() is None, "Firefox ended at once"
                assert time.monotonic() < end, "Firefox does not answer"
                time.sleep(0.2)

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of WebDriver BiDi and return its result; events are told meanwhile."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=ANSWER_S))
            if message["type"] == "event":
                for take in self._events:
                    take(message["method"], message["params"])
            elif message.get("id") == self._number:
                assert message["type"] == "success", f"{method}: {message}"
                result: dict[str, Any] = message["result"]
                return result

    def new_page(self, width: int, height: int) -> "FirefoxPage":
        """A new tab."""
        page = FirefoxPage(self, width, height)
        self._events.append(page.take)
        return page

    def close(self) -> None:
        """End Firefox."""
        self._end()

    def _end(self) -> None:
        self._process.terminate()
        self._process.wait(20)
        self._opened.close()
        self._profile.cleanup()


@contextmanager
def _display() -> Iterator[str]:
    """A display in memory, by its name."""
    assert XVFB is not None
    told, tell = os.pipe()
    process = subprocess.Popen(
        [XVFB, "-displayfd", str(tell), "-screen", "0", "1280x1024x24", "-nolisten", "tcp"],
        pass_fds=[tell],
        stderr=subprocess.DEVNULL,
    )
    os.close(tell)
    try:
        with open(told) as number:
            yield f":{number.readline().strip()}"
    finally:
        process.terminate()
        process.wait(20)


@contextmanager
def _sound_device() -> Iterator[dict[str, str]]:
    """A sound device that nobody hears, as the environment in which programs find it."""
    assert PULSEAUDIO is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        socket = Path(folder) / "socket"
        modules = ("module-null-sink", f"module-native-protocol-unix socket={socket} auth-anonymous=1")
        process = subprocess.Popen(
            [PULSEAUDIO, "-n", "--daemonize=no", "--exit-idle-time=-1", *(f"--load={module}" for module in modules)],
            env={**os.environ, "HOME": folder, "XDG_RUNTIME_DIR": folder},
            stderr=subprocess.DEVNULL,
        )
        try:
            end = time.monotonic() + START_S
            while not socket.exists():
                assert process.poll() is None, "PulseAudio ended at once"
                assert time.monotonic() < end, "PulseAudio does not answer"
                time.sleep(0.05)
            yield {"PULSE_SERVER": f"unix:{socket}"}
        finally:
            process.terminate()
            process.wait(20)


class FirefoxPage:
    """A tab of Firefox."""

    def __init__(self, firefox: Firefox, width: int, height: int) -> None:
        self._firefox = firefox
        self.has_sound = firefox.has_sound
        self._context = firefox.ask("browsingContext.create", type="tab")["context"]
        firefox.ask("browsingContext.setViewport", context=self._context, viewport={"width": width, "height": height})
        self._listeners: dict[str, list[Callable[[Any], None]]] = {"console": [], "pageerror": []}

    def on(self, event: str, listener: Callable[[Any], None]) -> None:
        """Call back for `console` or `pageerror`."""
        self._listeners[event].append(listener)

    def take(self, method: str, told: dict[str, Any]) -> None:
        """An event of any tab."""
        if method != "log.entryAdded" or told["source"].get("context") != self._context:
            return
        kind = {"warn": "warning"}.get(told["level"], told["level"])
        for listener in self._listeners["pageerror" if told["type"] == "javascript" else "console"]:
            listener(told["text"] if told["type"] == "javascript" else SimpleNamespace(type=kind, text=told["text"]))

    def goto(self, url: str, **_: object) -> None:
        """Open an address and wait until all that it names is loaded."""
        self._firefox.ask("browsingContext.navigate", context=self._context, url=url, wait="complete")

    @property
    def url(self) -> str:
        """The address that is shown."""
        return str(self.evaluate("location.href"))

    def evaluate(self, expression: str, argument: object = None) -> Any:
        """The value of an expression that is text, a number or true or false; a promise is awaited.

        With an argument the expression is a function that takes it.
        """
        if argument is not None:
            expression = f"({expression})({json.dumps(argument)})"
        done = self._firefox.ask(
            "script.evaluate",
            expression=expression,
            target={"context": self._context},
            awaitPromise=True,
            userActivation=True,
        )
        assert done["type"] == "success", done
        return done["result"].get("value")

    def wait_for_timeout(self, milliseconds: float) -> None:
        """Let time pass."""
        time.sleep(milliseconds / 1000)

    @property
    def keyboard(self) -> SimpleNamespace:
        """What presses keys."""
        return SimpleNamespace(press=lambda key: self._type([KEYS.get(key, key)]), type=self._type)

    def _type(self, letters: Iterable[str]) -> None:
        presses = [{"type": kind, "value": letter} for letter in letters for kind in ("keyDown", "keyUp")]
        keys = {"type": "key", "id": "keys", "actions": presses}
        self._firefox.ask("input.performActions", context=self._context, actions=[keys])

    def screenshot(self, path: Path, **_: object) -> None:
        """Write a PNG of what is seen."""
        shot = self._firefox.ask("browsingContext.captureScreenshot", context=self._context)
        Path(path).write_bytes(base64.b64decode(shot["data"]))

    def download(self, ask: Callable[[], None], folder: Path) -> Path:
        """Do what gives a file, and move that into a folder when it is complete."""
        ask()
        end = time.monotonic() + ANSWER_S
        while True:
            files = list(self._firefox.downloads.iterdir())
            if len(files) == 1 and files[0].suffix != ".part" and files[0].stat().st_size:
                return Path(shutil.move(files[0], folder / files[0].name))
            assert time.monotonic() < end, f"nothing came: {files}"
            time.sleep(0.1)

    def close(self) -> None:
        """Close the tab."""
        self._firefox.ask("browsingContext.close", context=self._context)
