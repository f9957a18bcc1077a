import argparse

import pytest

from echoavatar.cli import build_parser, main
from echoavatar.cli.options import local_path, size


def test_a_size_is_two_even_numbers() -> None:
    assert size("1280x720") == (1280, 720)


@pytest.mark.parametrize(("text", "complaint"), [("huge", "write it as"), ("101x64", "even"), ("8x64", "16 to 4096")])
def test_another_size_is_refused_with_its_form(text: str, complaint: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=complaint):
        size(text)


def test_an_address_is_no_path() -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="download it first"):
        local_path("https://example.org/talk.wav")


@pytest.mark.parametrize("given", ["-0.1", "1.5", "nan", "much"])
def test_a_share_that_is_none_is_told_what_is_wanted(given: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["animate", "a.wav", "-o", "a.glb", f"--liveliness={given}"])
    assert f"--liveliness: '{given}' is not a number from 0 to 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["say", "a.wav"], ["proxy", "--upstream", "wss://a"], ["elevenlabs", "setup"], ["camera"], ["mcp"]]
)
def test_a_client_takes_its_token_from_the_environment(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ECHOAVATAR_TOKEN", raising=False)
    assert build_parser(words[:1]).parse_args(words).token == ""
    monkeypatch.setenv("ECHOAVATAR_TOKEN", "secret")
    assert build_parser(words[:1]).parse_args(words).token == "secret"
    assert build_parser(words[:1]).parse_args([*words, "--token", "other"]).token == "other"


@pytest.mark.parametrize("given", ["-1", str(1 << 62), "9" * 5_000, "a"])
def test_a_seed_that_no_generator_takes_is_wrong_usage(given: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["animate", "a.wav", "-o", "a.glb", f"--seed={given}"])
    assert stop.value.code == 2
    assert "a seed is a number from 0 to" in capsys.readouterr().err
