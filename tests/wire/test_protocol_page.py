"""The protocol page: its examples run, and it is complete."""

import re
from pathlib import Path
from typing import get_args

from echoavatar.wire.messages import CLOSE_CODES, ClientMessage, ServerMessage

PAGE = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text()


def test_examples_run() -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(blocks) >= 2
    for block in blocks:
        exec(compile(block, "protocol.md", "exec"), {})


def test_every_message_is_explained() -> None:
    for kind in get_args(ClientMessage) + get_args(ServerMessage):
        tag = kind.__struct_config__.tag
        assert tag == "pong" or f"`{tag}`" in PAGE.split("## The clock")[0], tag


def test_every_error_is_explained() -> None:
    for code, number in CLOSE_CODES.items():
        assert re.search(rf"\| `{code}` \| ({number}|-) \|", PAGE), code
