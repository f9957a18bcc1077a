import pytest

from echoavatar import cli
from echoavatar.cli import COMMANDS, SEPARATE, main, plot


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert len(capsys.readouterr().out) > 150


def test_wrong_usage_is_exit_code_2() -> None:
    with pytest.raises(SystemExit) as stop:
        main(["no-such-command"])
    assert stop.value.code == 2


@pytest.mark.parametrize("command", SEPARATE)
def test_a_command_of_a_missing_distribution_says_how_to_get_it(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "entry_points", lambda **_: ())
    assert main([*command.split(), "--help"]) == 1
    error = capsys.readouterr().err
    assert f"pip install ./{SEPARATE[command]}" in error
    assert error.count("\n") == 1


def test_a_user_error_is_one_line_and_exits_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bundle", "no-such-bundle"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("echoavatar: no bundle 'no-such-bundle'")
    assert error.count("\n") == 1


def test_ctrl_c_exits_with_130(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def stop(args: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(plot, "run", stop)
    assert main(["plot", "runs/a", "-o", "a.png"]) == 130
    assert capsys.readouterr().err == "echoavatar: interrupted\n"
