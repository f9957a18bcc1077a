import json
from pathlib import Path

import pytest
from tests.server.fakes import serving

from echoavatar.cli import main


def test_a_dry_run_prints_what_would_be_sent(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["elevenlabs", "setup", "--dry-run", "--persona", "Mika"]) == 0
    told = json.loads(capsys.readouterr().out)
    names = [tool["tool_config"]["name"] for tool in told["tools"]]
    assert names == ["send_action", "set_manner", "play_music", "stop_music", "list_actions"]
    prompt = told["agent"]["conversation_config"]["agent"]["prompt"]["prompt"]
    assert "Mika" in prompt
    assert "raise_both_hands" in prompt


def test_a_servers_actions_and_a_custom_prompt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    prompt = tmp_path / "prompt.txt"
    prompt.write_text("You are a pirate.")
    with serving() as there:
        words = ["--server", f"http://{there.address}", "--prompt", str(prompt)]
        assert main(["elevenlabs", "setup", "--dry-run", *words, "--output-format", "pcm_24000"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["tools"][0]["tool_config"]["parameters"]["properties"]["action"]["enum"] == ["wave", "bow"]
    config = told["agent"]["conversation_config"]
    assert config["agent"]["prompt"]["prompt"] == "You are a pirate."
    assert config["tts"]["agent_output_audio_format"] == "pcm_24000"


def test_a_missing_key_or_prompt_is_an_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ELEVENLABS_API_KEY", raising=False)
    assert main(["elevenlabs", "setup"]) == 1
    assert "ELEVENLABS_API_KEY" in capsys.readouterr().err
    assert main(["elevenlabs", "setup", "--dry-run", "--prompt", "/no/such/file"]) == 1
    assert "cannot be read" in capsys.readouterr().err
