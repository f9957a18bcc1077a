"""The documents on voice agents are true: commands exist, examples run, links work."""

import argparse
import ast
import asyncio
import json
import re
import shlex
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.agents.proxy.places import avatar_server, proxied, tone
from tests.agents.proxy.scripted import ScriptedSession
from tests.server.fakes import RunningServer, serving

from echoavatar.agents.proxy import avatar_events, events
from echoavatar.cli import COMMANDS, command_module
from echoavatar.wire.messages import ActionStatus, Hello, Ready

ROOT = Path(__file__).parents[2]
NAMES = ("openai_realtime", "mcp", "local_agent")
PAGES = {name: (ROOT / f"docs/integrations/{name}.md").read_text() for name in NAMES}


def commands() -> list[str]:
    return [line.strip() for text in PAGES.values() for line in re.findall(r"^    (echoavatar .*)$", text, re.M)]


@pytest.mark.parametrize("line", commands())
def test_every_command_exists_with_its_options(line: str) -> None:
    _, command, *words = shlex.split(line, comments=True)
    assert command in COMMANDS
    parser = argparse.ArgumentParser(exit_on_error=False)
    command_module(command).add_arguments(parser)
    parser.parse_args(words)


@pytest.mark.parametrize("name", PAGES)
def test_examples_can_be_read_and_links_lead_somewhere(name: str) -> None:
    for code in re.findall(r"```python\n(.*?)```", PAGES[name], re.S):
        ast.parse(code)
    for code in re.findall(r"```json\n(.*?)```", PAGES[name], re.S):
        json.loads(code)
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", PAGES[name]):
        assert (ROOT / "docs/integrations" / target).exists(), target


def test_every_event_that_is_added_is_on_the_page() -> None:
    source = Path(avatar_events.__file__).read_text()
    kinds = set(re.findall(r'"((?:echoavatar|response)\.[a-z_.]+)"', source))
    assert len(kinds) >= 8
    assert [kind for kind in kinds if kind not in PAGES["openai_realtime"]] == []
    assert events.is_for_us('{"type": "echoavatar.played"}')


def test_every_variable_of_the_companion_is_on_its_page() -> None:
    source = (ROOT / "src/echoavatar/server/companion.py").read_text()
    names = set(re.findall(r'"(ECHOAVATAR_\w+)"', source))
    assert len(names) == 5
    assert [name for name in names if name not in PAGES["local_agent"]] == []


def example(name: str, **replaced: str) -> str:
    """The document's program, with other addresses."""
    [code] = re.findall(r"```python\n(.*?)```", PAGES[name], re.S)
    for old, new in replaced.values():
        assert old in code
        code = code.replace(old, new)
    return str(code)


@contextmanager
def conversation(place: RunningServer, connected: threading.Event, shown: threading.Event) -> Iterator[str]:
    """The proxy's address, before a scripted voice, in a thread of its own."""
    there, over, told = threading.Event(), threading.Event(), []

    async def greet(session: ScriptedSession) -> None:
        """One second of speech, when asked and the avatar is connected; the voice ends when frames were shown."""
        await session.until("response.create")
        await asyncio.to_thread(connected.wait, 30)
        await session.say(tone(1.0), pace=1.0)
        await asyncio.to_thread(shown.wait, 30)
        await session.websocket.close()

    async def stand() -> None:
        async with proxied(greet, place.address) as (url, _, _):
            told.append(url)
            there.set()
            await asyncio.to_thread(over.wait)

    thread = threading.Thread(target=lambda: asyncio.run(stand()), daemon=True)
    thread.start()
    assert there.wait(20)
    yield told[0]
    over.set()
    thread.join(20)


def test_the_example_with_openais_client_shows_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("openai")
    monkeypatch.setenv("OPENAI_API_KEY", "sk-test")
    connected, shown, make = threading.Event(), threading.Event(), avatar_events.session_created

    def made(ready: Ready) -> avatar_events.AvatarEvent:
        connected.set()
        return make(ready)

    monkeypatch.setattr(avatar_events, "session_created", made)
    printed: list[tuple[object, ...]] = []

    def note(*words: object) -> None:
        printed.append(words)
        if len(printed) == 2:
            shown.set()

    with avatar_server() as place, conversation(place, connected, shown) as url:
        code = example("openai_realtime", url=("ws://127.0.0.1:8766/v1", url.removesuffix("/realtime")))
        exec(compile(code, "openai_realtime.md", "exec"), {"print": note})
    assert printed[:2] == [("item_1", 0, 8), ("item_1", 8, 8)]


def test_the_example_with_mcps_client_makes_the_avatar_bow(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mcp")
    [line] = [line for line in commands() if "mcp --http" in line]
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    words = [port if word == "8767" else word for word in shlex.split(line, comments=True)]
    code = example("mcp", url=("8767", port))
    with serving() as place, place.call(Hello()) as caller:
        server = subprocess.Popen([sys.executable, "-m", *words, "--server", place.address])
        try:
            for _ in range(300):
                with socket.socket() as line_:
                    if line_.connect_ex(("127.0.0.1", int(port))) == 0:
                        break
                time.sleep(0.1)
            exec(compile(code, "mcp.md", "exec"), {})
        finally:
            server.terminate()
            server.wait(20)
        assert caller.until(ActionStatus).name == "bow"
    assert "accepted" in capsys.readouterr().out
