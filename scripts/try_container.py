"""Try the commands as a container runs them, without Docker: python scripts/try_container.py.

A namespace of Linux gets what compose.yaml says: a file system that is read-only, its tmpfs, no capabilities. The user
owns nothing, and has neither a name nor a home, as with `docker run --user 12345`. Each case takes more away. Kernels
that were compiled beside the package are read there; `--cold` hides them, and each command compiles for about a minute.
Prints one line a command; exits with status 1 if one fails. Needs root, unshare and setpriv.
"""

import argparse
import asyncio
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml

import echoavatar
from echoavatar import outgoing
from echoavatar.agents.client import connect
from echoavatar.models.audio.io import write_wav
from echoavatar.wire.messages import Motion

ROOT = Path(__file__).parents[1]
SERVICE = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]["echoavatar"]
NUMBA = re.findall(r"NUMBA_CACHE_DIR=\S+", (ROOT / "Dockerfile").read_text())
USER = 12345
SECONDS = 600
OUT = Path("/mnt")  # where a volume is mounted, in the namespace
CASES = {  # folders that can be written, variables
    "as compose.yaml": (SERVICE["tmpfs"], NUMBA),
    "no NUMBA_CACHE_DIR": (SERVICE["tmpfs"], []),
    "homes that are none": (SERVICE["tmpfs"], ["HOME=", "XDG_CACHE_HOME=cache", "XDG_CONFIG_HOME=config"]),
    "a home that is not there": (SERVICE["tmpfs"], ["HOME=/nonexistent", "TMPDIR=/nowhere"]),
    "nothing can be written": ([], ["NUMBA_CACHE_DIR=/nowhere"]),
}


def inside(words: list[str], writable: list[str], variables: list[str], volume: Path, is_cold: bool) -> list[str]:
    """The command line that runs these words in the namespace."""
    kept = Path(echoavatar.__file__).parent / "__pycache__" / "kernels"
    mounts = [
        "set -e",
        f"mount --bind {volume} {OUT}",
        *(f"mount -t tmpfs tmpfs {kept}" for _ in range(is_cold)),
        *shown(Path(sys.base_prefix)),
        "mount -o remount,ro,bind /",
        *(f"mount -t tmpfs -o mode=1777,noexec,nosuid,nodev tmpfs {folder}" for folder in writable),
    ]
    user = f"setpriv --reuid {USER} --regid {USER} --clear-groups --bounding-set=-all --inh-caps=-all --no-new-privs"
    environment = {
        "PATH": os.environ["PATH"], "PYTHONPATH": os.environ.get("PYTHONPATH", ""), "OMP_NUM_THREADS": "1"
    }  # fmt: skip
    given = [*(f"{name}={value}" for name, value in environment.items()), *variables]
    command = f"cd / && exec {user} env -i {shlex.join(given)} {shlex.join(words)}"
    return ["unshare", "--mount", "sh", "-c", "\n".join([*mounts, command])]


def shown(folder: Path) -> list[str]:
    """Let everybody enter a folder, which here may be in the home of root."""
    closed = [above for above in folder.parents if not above.stat().st_mode & 1]
    if not closed:
        return []
    aside = Path("/run/shown")
    return [
        "mount -t tmpfs tmpfs /run",
        f"mkdir {aside}",
        f"mount --bind {folder} {aside}",
        f"mount -t tmpfs tmpfs {closed[-1]}",
        f"mkdir -p {folder}",
        f"mount --bind {aside} {folder}",
        f"mount -o remount,ro,bind {folder}",
        f"mount -o remount,ro {closed[-1]}",
        "umount /run/shown",
        "mount -o remount,ro /run",
    ]


def serve(command: list[str]) -> str:
    """Start a server, ask for its page, and have a session move; returns what went wrong."""
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, text=True)
        assert process.stdout is not None
        try:
            first = process.stdout.readline()
            if (address := re.search(r"http://[^\s?]+", first)) is None:
                said.seek(0)
                return f"no address: {first}{said.read()}"
            url = address[0].rstrip("/")
            if b"<html" not in outgoing.fetch(f"{url}/", most=1 << 26).lower():
                return "the page is none"
            asyncio.run(asyncio.wait_for(move(url), 60))
            return ""
        finally:
            process.terminate()
            process.wait(30)


async def move(url: str) -> None:
    """Speak, and wait for a body that moves."""
    async with connect(url) as avatar:
        await avatar.speak(np.full(24_000, 0.1, np.float32))
        async for message in avatar:
            if isinstance(message, Motion) and message.rotations:
                return


def main() -> int:
    """Run all cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cold", action="store_true", help="hide the kernels that are compiled already")
    parser.add_argument("--case", choices=CASES, action="append", help="only this one")
    parser.add_argument("--command", choices=["say --help", "doctor", "animate", "serve"], help="only this one")
    args = parser.parse_args()
    if os.geteuid() or sys.platform != "linux":
        parser.exit(1, "this needs root on Linux: sudo env PATH=$PATH python scripts/try_container.py\n")
    if hidden := [folder for folder in SERVICE["tmpfs"] if Path(sys.prefix).is_relative_to(folder)]:
        parser.exit(1, f"the tmpfs of compose.yaml hides {sys.prefix}: clone outside {hidden[0]}\n")
    echo, failed = [sys.executable, "-m", "echoavatar"], 0
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        volume = Path(folder)
        volume.chmod(0o777)
        write_wav(volume / "talk.wav", 0.1 * np.sin(np.arange(48_000) / 20).astype(np.float32))
        commands = {
            "say --help": [*echo, "say", "--help"],
            "doctor": [*echo, "doctor"],
            "animate": [*echo, "animate", f"{OUT}/talk.wav", "-o", f"{OUT}/talk.glb"],
            "serve": [*echo, "serve", "--port", "0"],
        }
        for case in args.case or CASES:
            writable, variables = CASES[case]
            for name, words in commands.items():
                if args.command not in (None, name):
                    continue
                began = time.monotonic()
                command = inside(words, writable, variables, volume, args.cold)
                if name == "serve":
                    wrong, warnings = serve(command), ""
                else:
                    limited = ["timeout", str(SECONDS), *command]  # then the status is 124
                    done = subprocess.run(limited, capture_output=True, text=True)
                    wrong = f"status {done.returncode}: {done.stdout[-2000:]}{done.stderr[-2000:]}" * bool(
                        done.returncode
                    )
                    warnings = done.stderr.strip()
                failed += bool(wrong)
                mark, seconds = "!!" if wrong else "ok", time.monotonic() - began
                print(f"{mark}  {case:<26} {name:<11} {seconds:5.1f} s  {wrong or warnings}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
