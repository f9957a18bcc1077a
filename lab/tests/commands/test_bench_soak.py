import pytest

from echoavatar.cli import main


def test_a_soak_needs_a_model_that_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "soak", "--model", "nowhere", "--minutes", "0.01"]) == 1
    assert "nowhere" in capsys.readouterr().err
