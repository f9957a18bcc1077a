"""What Windows and macOS lack or do otherwise, simulated here: modules, functions, consoles and default encodings."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = [ROOT / name for name in ("src", "studio/src", "lab/src")]
ABSENT = """
import importlib, os, pkgutil, signal, sys
for name in ("resource", "fcntl", "termios", "pwd", "grp", "tty", "pty"):
    sys.modules[name] = None
for name in ("fork", "sched_getaffinity", "getuid", "geteuid", "killpg"):
    delattr(os, name)
for name in ("SIGKILL", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGALRM"):
    delattr(signal, name)
import echoavatar
failed = []
for module in pkgutil.walk_packages(echoavatar.__path__, "echoavatar."):
    if module.name.endswith("__main__"):
        continue
    try:
        importlib.import_module(module.name)
    except echoavatar.EchoAvatarError:  # an optional package is absent
        pass
    except Exception as error:
        failed.append(f"{module.name}: {type(error).__name__}: {error}")
from echoavatar.bench.stream import resident_mb
print(failed, resident_mb() >= 0)
"""


def test_every_module_loads_without_what_only_unix_has() -> None:
    """Third-party packages are loaded first where they would need it: they have guards of their own."""
    first = "import anyio, asyncio, multiprocessing, subprocess, torch, numba, tempfile, uvicorn, mcp, websockets\n"
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", first + ABSENT], capture_output=True, text=True)
    assert done.stdout.strip().endswith("[] True"), done.stdout[-2000:] + done.stderr[-2000:]


def test_text_files_are_utf_8_whatever_the_system_prefers() -> None:
    found = []
    for path in (path for source in SOURCES for path in source.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                name, given = node.func.attr, {keyword.arg for keyword in node.keywords}
                needed = {"read_text": 0, "write_text": 1}.get(name)
                if needed is not None and len(node.args) == needed and "encoding" not in given:
                    found.append(f"{path.name}:{node.lineno}")
    assert not found, f"no encoding given: {found}"


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_a_console_that_lacks_letters_gets_question_marks(encoding: str, tmp_path: Path) -> None:
    code = "from echoavatar.cli import main; main(['animate', '\\u58f0\\u97f3.wav', '-o', 'x.unknown'])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
    )
    assert b"Traceback" not in done.stderr
    assert done.stderr.startswith(b"echoavatar: ")
