"""`echoavatar proxy` as people start it: a server of its own, and its end."""

import asyncio
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.agents.proxy.places import silent
from tests.agents.proxy.scripted import ScriptedUpstream

from echoavatar.cli import main


def test_errors_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["proxy", "--upstream", "https://api.openai.com/v1/realtime"]) == 1
    told = capsys.readouterr().err
    assert "is not a WebSocket URL" in told
    assert told.count("\n") == 1


def test_it_starts_a_server_of_its_own_and_stops_it(tiny_bundle: Path) -> None:
    async def run() -> None:
        async with ScriptedUpstream(silent) as upstream:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "echoavatar", "proxy", "--upstream", upstream.url, "--port", "0"),
                *("--model", str(tiny_bundle)),
                stdout=subprocess.PIPE,
                env=os.environ | {"ECHOAVATAR_TOKEN": "secret"},
            )
            try:
                assert process.stdout is not None
                told = (await process.stdout.readline()).decode().split()
                from websockets.asyncio.client import connect

                async with connect(told[4], max_size=None) as line:
                    async for message in line:
                        if json.loads(message)["type"] == "echoavatar.animation_body.delta":
                            break
                process.send_signal(signal.SIGTERM)
                assert await asyncio.wait_for(process.wait(), 30) == 0
            finally:
                if process.returncode is None:
                    process.kill()

    asyncio.run(asyncio.wait_for(run(), 120))
