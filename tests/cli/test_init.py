import errno
import io
import logging
import os
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path

import pytest

from echoavatar import __version__, cli
from echoavatar.cli import COMMANDS, SEPARATE, build_parser, main
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.commands import plot


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


def test_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"echoavatar {__version__}\n"


@pytest.mark.parametrize(
    ("package", "told"),
    [
        ("elevenlabs", "elevenlabs: pip install 'echoavatar[elevenlabs]'"),
        ("echoavatar_lab", "echoavatar-lab: pip install ./lab in a clone of the repository"),
    ],
)
def test_a_missing_package_is_named_with_its_remedy(
    package: str, told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def needs(args: object) -> int:
        import_module(f"{package}.missing")
        return 0

    monkeypatch.setattr(plot, "run", needs)
    monkeypatch.setitem(sys.modules, package, None)
    assert main(["plot", "runs/a", "-o", "a.png"]) == 1
    assert capsys.readouterr().err == f"echoavatar: this needs {told}\n"


def test_a_closed_pipe_is_no_traceback() -> None:
    command = f"{sys.executable} -m echoavatar tools | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.stderr == ""
    assert done.stdout.strip() in ("0", "141")  # 0 where `true` was slower


@pytest.mark.parametrize("closed", [1, 2])
def test_an_output_that_is_closed_is_no_trouble(tmp_path: Path, closed: int) -> None:
    still = Motion.at_rest(HUMANOID)
    write_bvh(tmp_path / "a.bvh", HUMANOID, still.rotations, still.root, 30)
    words = [sys.executable, "-m", "echoavatar", "export", str(tmp_path / "a.bvh"), "-o", str(tmp_path / "a.npz")]
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {closed}>&-', "sh", *words], capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "a.npz").exists()


def test_output_to_a_full_disk_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fails(args: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(plot, "run", fails)
    assert main(["plot", "runs/a", "-o", "a.png"]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "No space left" in told


def test_no_two_services_share_a_port() -> None:
    """Two doors to the same page, `serve` and `demo`, have one."""
    parser = build_parser(["serve", "demo", "proxy", "mcp", "studio"])
    ports: dict[str, int] = {}
    for words in (["serve"], ["demo"], ["proxy", "--upstream", "ws://x"], ["mcp"], ["studio"]):
        ports[words[0]] = parser.parse_args(words).port
    assert ports.pop("demo") == ports["serve"]
    assert len(set(ports.values())) == len(ports)


def test_what_the_system_refuses_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def write(args: object) -> int:
        raise OSError(28, "No space left on device", "a\x1b[31m.png")

    monkeypatch.setattr(plot, "run", write)
    assert main(["plot", "runs/a", "-o", "a.png"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("echoavatar: cannot write a")
    assert "No space left on device" in error
    assert error.count("\n") == 1
    assert "\x1b" not in error


def test_no_name_commands_the_terminal() -> None:
    kept = io.BytesIO()
    shown = cli.Printable(io.TextIOWrapper(kept, "utf-8"))
    shown.write("red \x1b[31m, \x9b31m, back \u202egpj, \r\tUmlaut ä, 左\n")
    shown.flush()
    assert kept.getvalue().decode() == "red \\u001b[31m, \\u009b31m, back \\u202egpj, \\u000d\tUmlaut ä, 左\n"
    record = logging.LogRecord("a", logging.WARNING, "", 0, "%s is damaged", ("\x1b[2J.wav",), None)
    assert cli.LogFormat("%(message)s").format(record) == "\\u001b[2J.wav is damaged"


def test_a_command_runs_where_the_current_folder_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with pytest.raises(SystemExit):
        main(["--version"])
    assert os.getcwd() == os.sep
    told = capsys.readouterr()
    assert "is gone" in told.err
    assert told.out.startswith("echoavatar ")


def test_a_user_without_a_home_has_every_command(tmp_path: Path) -> None:
    """As containers have: an id without a name, and no folder of its own."""
    code = """
import os, pwd
def nobody(*_): raise KeyError("uid not found")
pwd.getpwuid = nobody
from echoavatar.cli import main
assert main(["export", "a.bvh", "-o", "b.glb"]) == 0
for command in ("animate", "say", "serve", "proxy", "doctor"):
    try:
        main([command, "--help"])
    except SystemExit as end:
        assert not end.code
"""
    made = Motion.at_rest(HUMANOID)
    write_bvh(tmp_path / "a.bvh", HUMANOID, made.rotations, made.root, 30)
    kept = {name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_CACHE_HOME")}
    kept["PYTHONPATH"] = os.pathsep.join([*sys.path[1:], kept.get("PYTHONPATH", "")])
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, env=kept, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert (tmp_path / "b.glb").is_file()


def test_without_any_temporary_folder_it_says_what_to_set(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(_: object) -> int:
        monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: [os.devnull])
        monkeypatch.setattr(tempfile, "tempdir", None)
        with tempfile.TemporaryDirectory():
            return 0

    monkeypatch.setattr("echoavatar.cli.doctor.run", run)
    assert main(["doctor"]) == 1
    assert "TMPDIR" in capsys.readouterr().err


def test_a_log_file_gets_no_progress_bars() -> None:
    """Of no command: whoever makes a bar, those of the lab too."""
    code = "from echoavatar.cli import main; main(['completion', 'bash'])\nfrom tqdm import tqdm\nlist(tqdm(range(3)))"
    environment = {name: value for name, value in os.environ.items() if name != "TQDM_DISABLE"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
