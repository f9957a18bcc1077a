"""The page about serving: its example runs against a real server."""

import asyncio
import re
from pathlib import Path

import numpy as np
import pytest
from tests.server.fakes import serving

PAGE = (Path(__file__).parents[2] / "docs" / "serving.md").read_text()


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(block, "serving.md", "exec"), names)
    with serving() as place:
        asyncio.run(names["say"](place.address, np.full(12_000, 0.1, np.float32)))  # type: ignore[operator]
    assert capsys.readouterr().out.strip().endswith(", 52, 4)")


def test_flags_that_are_named_are_there() -> None:
    import argparse

    from echoavatar.cli.serve import add_arguments

    parser = argparse.ArgumentParser()
    add_arguments(parser)
    known = {option for action in parser._actions for option in action.option_strings}
    named = set(re.findall(r"(?<![\w-])--[a-z]+", PAGE)) - {"--server", "--neighbours"}
    assert named <= known
