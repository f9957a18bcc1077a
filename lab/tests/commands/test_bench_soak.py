import pytest

from echoavatar.cli import main


def test_its_help_says_what_a_soak_does_and_when_it_fails(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", "soak", "--help"])
    assert ended.value.code == 0
    told = capsys.readouterr().out
    assert "--faults" in told
    assert "--minutes" in told
