"""Every command of the documents on sinks and exports exists with its options; `export` and `play` are run."""

import argparse
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.bodies import make_rigs
from tests.files.exports.moving import clapping
from tests.server.sinks.receiving import Receiver

from echoavatar.cli import COMMANDS, command_module, main
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.formats.tables import write_npz
from echoavatar.server.sinks import check_address, parse_address

ROOT = Path(__file__).parents[2]
NAMES = ("vmc", "live_link", "exports", "unity", "unreal", "blender")
PAGES = [ROOT / "docs/integrations" / f"{name}.md" for name in NAMES]


def commands() -> list[str]:
    found: list[str] = []
    for page in PAGES:
        text = page.read_text()
        blocks = re.findall(r"```sh\n(.*?)```", text, re.S)
        found += [line.strip() for block in blocks for line in block.splitlines() if "echoavatar " in line]
        inline = re.sub(r"```sh\n.*?```", "", text, flags=re.S)
        found += list(re.findall(r"`(echoavatar [^`]+ [^`]+)`", inline))
    return sorted({line for line in found if not line.startswith("pip")})


@pytest.mark.parametrize("line", commands())
def test_every_command_exists_with_its_options(line: str) -> None:
    program, command, *words = shlex.split(line, comments=True)
    assert (program, command in COMMANDS) == ("echoavatar", True)
    parser = argparse.ArgumentParser(exit_on_error=False)
    command_module(command).add_arguments(parser)
    args = parser.parse_args(words)
    for sink in getattr(args, "sink", []):
        if not sink.startswith("unity:") and "HOST" not in sink:
            check_address(sink)
        parse_address(sink)


def runnable() -> list[str]:
    slow = (".fbx", ".mp4")
    return [line for line in commands() if line.split()[1] in ("export",) and not any(end in line for end in slow)]


def test_every_export_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rigs = make_rigs(tmp_path)
    rigs["child"].rename("me.vrm")
    rigs["tall"].rename("rig.bvh")
    motion = clapping(0.4)
    face = np.zeros((motion.frames, 52), np.float32)
    write_npz("talk.npz", motion, face=face, face_names=np.array(ARKIT_NAMES))
    write_bvh("clip.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    lines = runnable()
    assert len(lines) >= 9
    for line in lines:
        words = shlex.split(line, comments=True)[1:]
        if ".usd" in line:
            pytest.importorskip("pxr")
        assert main(words) == 0, line
        assert Path(words[words.index("-o") + 1]).stat().st_size > 500


def test_a_played_recording_arrives(tmp_path: Path) -> None:
    motion = clapping(0.4)
    write_npz(tmp_path / "talk.npz", motion)
    with Receiver() as receiver:
        assert main(["play", str(tmp_path / "talk.npz"), "--sink", f"livelink://127.0.0.1:{receiver.port}"]) == 0
        assert len(receiver.packets(5)) == 5


def test_every_link_leads_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
