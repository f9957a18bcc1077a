import json

import pytest

from echoavatar.cli import main


@pytest.mark.parametrize("stage", ["generator", "tokenizer"])
def test_the_command_ends_with_a_line_of_json(stage: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "train", "--stage", stage, "--steps", "1", "--batch", "2"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["stage"] == stage
    assert (told["share"] is None) == (stage == "tokenizer")
    assert told["step_seconds"] > 0
