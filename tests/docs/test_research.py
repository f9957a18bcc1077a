"""Every command of docs/research.md exists with its options, and its estimates are computed correctly."""

import argparse
import re
import shlex
from pathlib import Path

import pytest

from echoavatar.cli import COMMANDS, command_module

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/research.md").read_text()


def commands() -> list[str]:
    lines = [line for block in re.findall(r"```sh\n(.*?)```", TEXT, re.S) for line in block.strip().splitlines()]
    return [re.sub(r"^accelerate launch --num_processes \d+ -m ", "", line) for line in lines]


@pytest.mark.parametrize("line", commands())
def test_every_command_exists_with_its_options(line: str) -> None:
    program, command, *words = shlex.split(line, comments=True)
    assert (program, command in COMMANDS) == ("echoavatar", True)
    parser = argparse.ArgumentParser(exit_on_error=False)
    command_module(command).add_arguments(parser)
    args = parser.parse_args(words)
    assert (ROOT / args.recipe).is_file() if str(getattr(args, "recipe", "")).endswith(".yaml") else True


def test_every_link_leads_somewhere() -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", TEXT):
        assert (ROOT / "docs" / target).exists(), target


def test_the_sums_are_right() -> None:
    """Repeats the arithmetic of the estimates."""
    step = (6 * 0.358e9 + 12 * 24 * 896 * 1140) * 1140 * 256
    seconds = step / (0.35 * 989e12)
    assert f"{seconds:.2f} s a step" in TEXT
    assert f"{40_000 * seconds / 3600:.1f} h | {40_000 * seconds / 3600 / 1.9:.1f} h" in TEXT
    assert f"= {(52 * 16 + 13 + 1600) * 108_000 / 1e6:.0f} MB an hour" in TEXT
