import pytest

from echoavatar.cli import main


def test_an_unknown_neighbour_is_said_with_those_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "neighbours", "--only", "the dog"]) == 1
    assert "choose from nobody, offers" in capsys.readouterr().err
