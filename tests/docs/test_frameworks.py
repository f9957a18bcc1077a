"""The documents on Pipecat, LiveKit and ElevenLabs: every command runs as far as possible without keys.

What is installed is checked against what the packages offer; programs run until they say what the page says of them, or
ask for what a newcomer lacks. Hosted services are a port on this machine.
"""

import ast
import importlib.metadata
import importlib.util
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = {name: (ROOT / f"docs/integrations/{name}.md").read_text() for name in ("pipecat", "livekit", "elevenlabs")}
NOBODY = "ws://127.0.0.1:9"  # a port without a server
KEYS = {"OPENAI_API_KEY": "none", "LIVEKIT_URL": NOBODY, "LIVEKIT_API_KEY": "devkey", "LIVEKIT_API_SECRET": "secret"}


def commands(start: str) -> list[str]:
    """Commands of all documents with this prefix, without leading assignments, split at `&&`."""
    lines = [
        part.strip()
        for text in PAGES.values()
        for block in re.findall(r"```sh\n(.*?)```", text, re.S)
        for line in block.splitlines()
        for part in line.split("&&")
    ]
    return [found for line in lines if (found := re.sub(r"^([A-Z_]+=\S+ )+", "", line)).startswith(start)]


def says(words: list[str], wanted: str, *, seconds: float = 100, **keys: str) -> str:
    """Output of a program until it prints a text or ends; the program is then stopped."""
    kept = {name: value for name, value in os.environ.items() if not name.endswith(("_KEY", "_SECRET", "_URL"))}
    process = subprocess.Popen(
        [sys.executable, *words],
        cwd=ROOT,
        env=kept | keys | {"PYTHONUNBUFFERED": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    assert process.stdout is not None
    os.set_blocking(process.stdout.fileno(), False)
    printed, end = "", time.monotonic() + seconds
    while wanted not in printed and time.monotonic() < end:
        is_over = process.poll() is not None
        printed += (process.stdout.read() or b"").decode()
        if is_over:
            break
        time.sleep(0.1)
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    process.stdout.close()
    return printed


def test_no_command_is_left_out() -> None:
    kinds = ("python3 -m venv", ". .venv", "pip install", "python ", "echoavatar ", "export ")
    assert sorted(line for kind in kinds for line in commands(kind)) == sorted(commands(""))


@pytest.mark.parametrize("line", sorted(set(commands("pip install"))))
def test_what_is_installed_is_there_with_its_extras(line: str) -> None:
    words = shlex.split(line)[2:]
    if "-c" in words:
        assert (ROOT / words.pop(words.index("-c") + 1)).is_file()
    for word in (word for word in words if not word.startswith("-")):
        name, _, extras = word.rstrip("]").partition("[")
        if name.startswith("."):
            project = tomllib.loads((ROOT / name / "pyproject.toml").read_text())["project"]
            offered = set(project.get("optional-dependencies", {}))
        else:
            pytest.importorskip(name.replace("-ai", "").replace("-agents", ".agents"))
            offered = set(importlib.metadata.metadata(name).get_all("Provides-Extra") or [])
        assert set(extras.split(",")) - {""} <= offered


def test_python_on_the_pages_can_be_read_and_links_lead_somewhere() -> None:
    for text in PAGES.values():
        for code in re.findall(r"```python\n(.*?)```", text, re.S):
            compile(code, "page", "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", text):
            assert (ROOT / "docs/integrations" / target).exists(), target


@pytest.mark.slow
def test_the_offline_bot_comes_up() -> None:
    pytest.importorskip("pipecat_echoavatar")
    [line] = commands("python integrations/pipecat-echoavatar/examples/offline.py")
    assert "type something" in says([*shlex.split(line)[1:], "--port", "0"], "type something", seconds=240)


def test_the_hosted_bot_asks_for_its_key_and_waits_for_a_visitor() -> None:
    pytest.importorskip("pipecat_echoavatar")
    [line] = commands("python integrations/pipecat-echoavatar/examples/hosted.py")
    assert "set OPENAI_API_KEY" in says(shlex.split(line)[1:], "set OPENAI_API_KEY")
    for name in ("aiortc", "fastapi"):
        pytest.importorskip(name, reason="pip install 'pipecat-ai[webrtc,runner,silero,openai]'")
    assert "/client" in says([*shlex.split(line)[1:], "--port", "7861"], "/client", **KEYS)


def test_the_livekit_agent_asks_for_its_key_and_looks_for_the_server() -> None:
    pytest.importorskip("livekit.plugins.echoavatar")
    [line] = commands("python integrations/livekit-plugins-echoavatar/examples/agent.py")
    assert "set OPENAI_API_KEY" in says(shlex.split(line)[1:], "set OPENAI_API_KEY")
    assert "failed to connect" in says(shlex.split(line)[1:], "failed to connect", **KEYS)


def test_the_livekit_worker_says_that_nobody_is_there() -> None:
    pytest.importorskip("livekit.plugins.echoavatar")
    [line] = commands("python -m livekit.plugins.echoavatar")
    words = [NOBODY if word.startswith("ws:") else word for word in shlex.split(line)[1:]]
    assert "cannot join" in says(words, "cannot join")


def test_the_elevenlabs_setup_prints_what_it_would_send() -> None:
    dry, real = commands("echoavatar elevenlabs setup")
    assert '"play_music"' in says(["-m", *shlex.split(dry)], "no such text")
    assert "ELEVENLABS_API_KEY" in says(["-m", *shlex.split(real)], "no such text")


def test_talking_with_elevenlabs_asks_for_its_key() -> None:
    pytest.importorskip("elevenlabs")
    [line] = commands("python integrations/elevenlabs/examples/talk.py")
    assert "ELEVENLABS_API_KEY" in says(shlex.split(line)[1:], "ELEVENLABS_API_KEY")


def test_talking_with_elevenlabs_is_a_conversation(monkeypatch: pytest.MonkeyPatch) -> None:
    """The unchanged example, with a scripted service, a recording audio output and a fake body."""
    pytest.importorskip("elevenlabs")
    from elevenlabs import ElevenLabs
    from tests.agents.integrations import test_elevenlabs as scene

    from echoavatar.agents.integrations.elevenlabs import AvatarAudioInterface

    spec = importlib.util.spec_from_file_location("talk", ROOT / "integrations/elevenlabs/examples/talk.py")
    assert spec is not None
    assert spec.loader is not None
    example, device = importlib.util.module_from_spec(spec), scene.Device()
    spec.loader.exec_module(example)

    def script(talk: scene.Talk) -> None:
        talk.speak(scene.tone(1.0, 16_000), 16_000)
        scene.wait(lambda: len(device.heard) > 12_000)
        assert not talk.call("send_action", action="wave")["is_error"]

    with scene.service(script) as url:
        monkeypatch.setattr(example, "DefaultAudioInterface", lambda: device)
        monkeypatch.setattr(example, "ElevenLabs", lambda api_key: ElevenLabs(api_key=api_key, base_url=url))
        monkeypatch.setattr(
            example,
            "AvatarAudioInterface",
            lambda _, **given: AvatarAudioInterface(scene.engine(), **given | {"page_port": None}),
        )
        monkeypatch.setattr(sys, "argv", ["talk.py", "agent"])
        monkeypatch.setenv("ELEVENLABS_API_KEY", "none")
        example.main()
    assert len(device.heard) > 12_000
