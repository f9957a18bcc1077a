import os
from pathlib import Path

import pytest

from echoavatar.cli import build_parser
from echoavatar.cli.settings import config_path
from echoavatar.errors import EchoAvatarError


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "config.toml"
    path.write_text("")
    monkeypatch.setenv("ECHOAVATAR_CONFIG", str(path))
    return path


def test_what_is_typed_wins_over_the_environment_and_that_over_the_file(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config.write_text('model = "a"\n[serve]\nport = 9000\nopen = true\nsink = ["vmc://x"]\n[bench.stream]\nseconds = 7')
    parser = build_parser(["serve"])
    found = parser.parse_args(["serve"])
    assert (found.model, found.port, found.open, found.sink) == ("a", 9000, True, ["vmc://x"])
    assert build_parser(["bench"]).parse_args(["bench", "stream"]).seconds == 7.0
    monkeypatch.setenv("ECHOAVATAR_MODEL", "b")
    monkeypatch.setenv("ECHOAVATAR_SERVE_PORT", "9001")
    found = build_parser(["serve"]).parse_args(["serve"])
    assert (found.model, found.port) == ("b", 9001)
    assert build_parser(["bench"]).parse_args(["bench", "stream"]).model == "b"
    found = build_parser(["serve"]).parse_args(["serve", "--model", "c", "--port", "1"])
    assert (found.model, found.port) == ("c", 1)
    monkeypatch.setenv("ECHOAVATAR_MODEL", "")  # empty is unset: an empty token must not open a server to a network
    assert build_parser(["bench"]).parse_args(["bench", "stream"]).model == "a"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[serve]\nprot = 1\n", "no option 'prot'"),
        ("[serve\n", "cannot read"),
        ('[serve]\nopen = "maybe"\n', "true or false"),
        ('[serve]\nlog = "xml"\n', "choose one of"),
    ],
)
def test_what_cannot_be_meant_is_refused(config: Path, text: str, said: str) -> None:
    config.write_text(text)
    with pytest.raises(EchoAvatarError, match=said):
        build_parser(["serve"])


def test_a_file_need_not_exist_unless_it_is_named(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config.unlink()
    with pytest.raises(EchoAvatarError, match="cannot be read"):
        build_parser(["serve"])
    monkeypatch.delenv("ECHOAVATAR_CONFIG")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(config.parent / "nowhere"))
    build_parser(["serve"])
    assert config_path({"XDG_CONFIG_HOME": "/x"}).as_posix() == "/x/echoavatar/config.toml"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("serve = 3\n", "serve is a command"),
        ("[bench]\nstream = 3\n", "stream is a command"),
        ('[serve]\nverbose = "loud"\n', "the setting verbose is 'loud'"),
        ("a = " + "[" * 20_000, "cannot read"),
        ("a = " + "9" * 5_000, "cannot read"),
    ],
)
def test_nonsense_in_the_file_is_one_error(config: Path, text: str, said: str) -> None:
    config.write_text(text)
    with pytest.raises(EchoAvatarError, match=said):
        build_parser(["serve", "bench"])


@pytest.mark.parametrize("named", ["{folder}/pipe", "/dev/zero", "a" * 5_000, "~nobody-here/config.toml", "{folder}"])
def test_a_configuration_that_is_no_file_is_one_error(
    named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setenv("ECHOAVATAR_CONFIG", named.format(folder=tmp_path))
    with pytest.raises(EchoAvatarError, match="cannot be read|not a regular file"):
        build_parser(["serve"])


def test_an_option_of_two_values_takes_two(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ECHOAVATAR_HOLD", "1,2.5")
    assert build_parser(["actions"]).parse_args(["actions", "add", "bow", "bow.bvh"]).hold == [1.0, 2.5]
    for given in ("3", "a,b"):
        monkeypatch.setenv("ECHOAVATAR_HOLD", given)
        with pytest.raises(EchoAvatarError, match="the setting hold is"):
            build_parser(["actions"])
