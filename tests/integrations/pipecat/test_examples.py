"""The hosted example is built; the offline example is run."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pipecat_echoavatar", reason="pip install ./integrations/pipecat-echoavatar")

from pipecat_echoavatar import EchoAvatarProcessor, NullTransport
from tests.integrations.pipecat.scene import engine

EXAMPLES = Path(__file__).parents[3] / "integrations/pipecat-echoavatar/examples"


def load(name: str) -> Any:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


async def test_the_hosted_bot_can_be_built(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "none")
    avatar = EchoAvatarProcessor(engine())
    worker = await load("hosted").build(NullTransport(), NullTransport(), avatar)
    assert worker is not None
    await avatar.bridge.close()


async def test_the_offline_companion_obeys() -> None:
    offline = load("offline")
    avatar = EchoAvatarProcessor(engine())
    await avatar.prepare()
    assert "Like this" in await offline.obey("please wave at me", avatar.tool_calls)
    assert "mine" in await offline.obey("Let us dance.", avatar.tool_calls)
    assert "still" in await offline.obey("stop", avatar.tool_calls)
    assert "tell me more" in await offline.obey("tell me more", avatar.tool_calls)
    await avatar.bridge.close()


@pytest.mark.slow
@pytest.mark.skipif(not (shutil.which("flite") or shutil.which("espeak-ng")), reason="no voice here")
def test_the_offline_bot_runs() -> None:
    words = [sys.executable, str(EXAMPLES / "offline.py"), "--port", "0"]
    done = subprocess.run(words, input="hello\n\n", capture_output=True, text=True, timeout=240, check=True)
    assert "/?watch=" in done.stdout
    assert "hello" in done.stdout
