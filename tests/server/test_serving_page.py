"""The page about serving: its example runs against a real server."""

import argparse
import asyncio
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.server.fakes import serving

PAGE = (Path(__file__).parents[2] / "docs" / "serving.md").read_text()


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(block, "serving.md", "exec"), names)
    with serving() as server:
        asyncio.run(names["say"](server.address, np.full(12_000, 0.1, np.float32)))  # type: ignore[operator]
    assert capsys.readouterr().out.strip().endswith(", 52, 4)")


def test_flags_that_are_named_are_there() -> None:
    from echoavatar.cli import bench, say, serve

    known = {option for room in (serve, say) for option in options(room.add_arguments)}
    known |= options(bench.add_arguments, "sessions")
    ours = re.sub(r"`buildah[^`]*`", "", PAGE)
    assert set(re.findall(r"(?<![\w-])--[a-z]+(?:-[a-z]+)*", ours)) <= known


def options(add: Callable[[argparse.ArgumentParser], None], kind: str = "") -> set[str]:
    """Flags of a command, or of one of its kinds."""
    parser = argparse.ArgumentParser()
    add(parser)
    if kind:
        (parser,) = (a.choices[kind] for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return {option for action in parser._actions for option in action.option_strings}
