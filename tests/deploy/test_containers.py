"""The container files, checked without a daemon: the files and options that they name exist."""

import argparse
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from echoavatar.cli.options import TOKEN
from echoavatar.cli.serve import add_arguments

ROOT = Path(__file__).parents[2]
DOCKER = (ROOT / "Dockerfile").read_text()
SERVICE: dict[str, Any] = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]["echoavatar"]

ON_GPU: dict[str, Any] = yaml.safe_load((ROOT / "compose.gpu.yaml").read_text())["services"]["echoavatar"]


def lines(word: str) -> list[str]:
    """The arguments of every such instruction; continued lines are joined."""
    whole = DOCKER.replace("\\\n", " ")
    return [line.split(None, 1)[1] for line in whole.splitlines() if line.startswith(f"{word} ")]


def parsed(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(exit_on_error=False)
    add_arguments(parser)
    return parser.parse_args(arguments)


def without_defaults(text: str) -> str:
    """`${NAME:-value}` as compose reads it where nothing is set."""
    return re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text)


def test_every_file_that_is_copied_is_there_and_let_through() -> None:
    let_through = (ROOT / ".dockerignore").read_text().split()
    sources = [part for line in lines("COPY") if "--from" not in line for part in line.split()[:-1]]
    assert {"constraints.txt", "pyproject.toml", "src"} <= {Path(source).name for source in sources}
    for source in sources:
        assert (ROOT / source).exists(), source
        assert f"!{Path(source).as_posix()}" in let_through
    for house in (Path(), Path("lab")):
        project = tomllib.loads((ROOT / house / "pyproject.toml").read_text())["project"]
        read = {(house / name).as_posix() for name in (project["readme"], *project["license-files"])}
        assert read <= set(sources), "setuptools reads them"


def test_the_extras_that_are_installed_exist_and_only_a_gpu_brings_the_lab() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    (asked,) = re.findall(r'"\.\[\$\{(\w+)\}\]"', DOCKER)
    (usual,) = [word.removeprefix(f"{asked}=") for word in lines("ARG") if word.startswith(f"{asked}=")]
    assert usual == "serve"
    assert usual in extras
    assert "LAB=" in lines("ARG"), "no lab, unless it is asked for"
    assert sum("pip install" in line and line.endswith("${LAB}") for line in lines("RUN")) == 1
    assert ON_GPU["build"]["args"] == {"LAB": "./lab"}
    lab = tomllib.loads((ROOT / ON_GPU["build"]["args"]["LAB"] / "pyproject.toml").read_text())["project"]
    assert any(needed.startswith("torch>") for needed in lab["dependencies"])


def test_the_base_is_pinned_by_one_argument() -> None:
    """The same base for both stages, so that a digest pins the whole image."""
    assert [line.split()[0] for line in lines("FROM")] == ["${PYTHON}"] * 2
    assert "PYTHON=python:3.11-slim" in lines("ARG")
    assert "--build-arg PYTHON=python:3.11-slim@sha256:" in DOCKER


def test_it_runs_as_nobody_and_ends_by_a_signal_that_drains() -> None:
    assert lines("USER") == ["avatar"]
    assert lines("STOPSIGNAL") == ["SIGTERM"]
    assert DOCKER.index("USER avatar") > DOCKER.rindex("RUN ")
    grace = int(re.fullmatch(r"(\d+)s", SERVICE["stop_grace_period"])[1])  # type: ignore[index]
    assert grace > parsed([]).drain


@pytest.mark.parametrize("command", [yaml.safe_load(lines("CMD")[-1]), SERVICE["command"], ON_GPU["command"]])
def test_the_command_line_is_understood(command: list[str]) -> None:
    program, room, *fixed = yaml.safe_load(lines("ENTRYPOINT")[0])
    assert (program, room) == ("echoavatar", "serve")
    options = parsed([*fixed, *(without_defaults(word) for word in command)])
    assert options.host == "0.0.0.0"
    assert lines("EXPOSE") == [str(options.port)]
    assert f":{options.port}/health" in DOCKER


def test_ports_folders_and_variables_fit() -> None:
    (port,) = SERVICE["ports"]
    assert without_defaults(port) == "127.0.0.1:8765:8765", "this machine only, unless it is asked for"
    (volume,) = SERVICE["volumes"]
    assert without_defaults(volume).split(":")[1] in SERVICE["command"]
    assert TOKEN in SERVICE["environment"]
    page = (ROOT / "docs" / "serving.md").read_text()
    for name in re.findall(r"\$\{(ECHOAVATAR_\w+)", (ROOT / "compose.yaml").read_text()):
        assert name in page, f"{name} is not in docs/serving.md"


def test_a_read_only_container_can_keep_what_it_compiles() -> None:
    """A processor for which the image holds no kernels compiles them where it can write."""
    assert SERVICE["read_only"]
    (kept,) = re.findall(r"NUMBA_CACHE_DIR=(\S+)", DOCKER)
    assert any(Path(kept).is_relative_to(folder) for folder in SERVICE["tmpfs"])


def test_the_image_holds_its_kernels() -> None:
    """`doctor` compiles them beside the package: as root, and before another place is named."""
    final = DOCKER[DOCKER.rindex("FROM ") :]
    compiled = final.index("RUN echoavatar doctor")
    assert final.index("COPY --from=build") < compiled < final.index("NUMBA_CACHE_DIR") < final.index("USER ")
    assert "NUMBA_CACHE_DIR" not in DOCKER[: DOCKER.rindex("FROM ")]


def test_the_health_check_asks_no_proxy() -> None:
    """Docker hands its own proxy to containers in HTTP_PROXY."""
    assert "echoavatar.outgoing" in DOCKER[DOCKER.index("HEALTHCHECK") :]
    assert "urlopen" not in DOCKER


def test_the_gpu_is_reserved_and_used_by_a_build_that_knows_it() -> None:
    (device,) = ON_GPU["deploy"]["resources"]["reservations"]["devices"]
    assert (device["driver"], device["capabilities"]) == ("nvidia", ["gpu"])
    options = parsed([without_defaults(word) for word in ON_GPU["command"]])
    assert (options.device, options.music) == ("cuda", Path("/music")), "a command replaces the one below it"
    (asked,) = ON_GPU["build"]["args"]
    assert f"ARG {asked}=" in DOCKER
    assert set(ON_GPU) <= {*SERVICE, "deploy"}


def test_the_container_is_bounded() -> None:
    assert without_defaults(SERVICE["mem_limit"]) == without_defaults(SERVICE["memswap_limit"]) == "4g"
    assert int(without_defaults(str(SERVICE["pids_limit"]))) <= 1024
    assert SERVICE["ulimits"]["nofile"]["hard"] >= 4_096 + 256  # sockets that the server keeps (server/run.py)
    assert SERVICE["logging"]["options"]["max-size"]
    documented = (ROOT / "docs" / "serving.md").read_text()
    for name in re.findall(r"\$\{(\w+):-", (ROOT / "compose.yaml").read_text()):
        assert name in documented, name


def test_a_file_with_the_token_is_not_committed_by_accident() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a clone")
    for name in (".env", ".env.local"):
        assert subprocess.run(["git", "check-ignore", "-q", name], cwd=ROOT, check=False).returncode == 0, name


SERVES = ["--command", "serve", "--case", "as compose.yaml", "--case", "nothing can be written"]


@pytest.mark.parametrize("words", [SERVES, pytest.param([], marks=pytest.mark.slow)], ids=["the page", "all commands"])
def test_the_commands_run_with_the_settings_of_compose(words: list[str]) -> None:
    if subprocess.run(["unshare", "--mount", "true"], capture_output=True, check=False).returncode:
        pytest.skip("no namespace may be made here")
    if hidden := [folder for folder in SERVICE["tmpfs"] if Path(sys.prefix).is_relative_to(folder)]:
        pytest.skip(f"the tmpfs of compose.yaml hides {sys.prefix}: clone outside {hidden[0]}")
    program = [sys.executable, ROOT / "scripts" / "try_container.py", *words]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert not words or done.stdout.count("ok ") == 2
