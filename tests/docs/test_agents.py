"""The pages on voice agents tell the truth: commands exist, examples are Python, links lead somewhere."""

import argparse
import ast
import importlib
import json
import re
import shlex
from pathlib import Path

import pytest

from echoavatar.cli import COMMANDS, _module
from echoavatar.proxy import added, events

ROOT = Path(__file__).parents[2]
NAMES = ("openai_realtime", "mcp", "local_agent")
PAGES = {name: (ROOT / f"docs/integrations/{name}.md").read_text() for name in NAMES}


def commands() -> list[str]:
    return [
        line.strip() for text in PAGES.values() for line in re.findall(r"^    (echoavatar .*)$", text, re.M)
    ]


@pytest.mark.parametrize("line", commands())
def test_every_command_exists_with_its_options(line: str) -> None:
    _, command, *words = shlex.split(line, comments=True)
    assert command in COMMANDS
    parser = argparse.ArgumentParser(exit_on_error=False)
    importlib.import_module(_module(command), "echoavatar.cli").add_arguments(parser)
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
    source = Path(added.__file__).read_text()
    kinds = set(re.findall(r'"((?:echoavatar|response)\.[a-z_.]+)"', source))
    assert len(kinds) >= 8
    assert [kind for kind in kinds if kind not in PAGES["openai_realtime"]] == []
    assert events.is_for_us('{"type": "echoavatar.played"}')


def test_every_variable_of_the_companion_is_on_its_page() -> None:
    source = (ROOT / "src/echoavatar/companion/talk.py").read_text()
    names = set(re.findall(r'"(ECHOAVATAR_\w+)"', source))
    assert len(names) == 5
    assert [name for name in names if name not in PAGES["local_agent"]] == []
