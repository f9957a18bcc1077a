import json
from typing import get_args

import pytest

from echoavatar.cli import main
from echoavatar.cli.tools import FORMS
from echoavatar.engine.tools import Style


def test_every_form_there_is_can_be_asked_for() -> None:
    assert set(FORMS) == set(get_args(Style))


@pytest.mark.parametrize("form", ["openai", "elevenlabs", "gemini"])
def test_they_are_printed_as_json(form: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tools", "--format", form]) == 0
    printed = capsys.readouterr().out
    assert json.loads(printed)
    assert '"wave"' in printed
    assert '"Evening Waltz"' in printed
