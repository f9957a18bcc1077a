"""Try every command of a user on an installed `echoavatar`: files, a live server, its clients, and no lab.

    python scripts/try_avatar.py speech.ogg     # in an empty folder; needs echoavatar[serve,mcp]

`make release-check` runs it in an environment that holds the avatar's wheel alone. Prints one line a command; exits
with 1 at the first that fails.
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from echoavatar import outgoing

COMMAND = [sys.executable, "-m", "echoavatar"]
WAIT_S = 180.0  # for a server: the first run on a machine compiles
INITIALIZE = {
    "jsonrpc": "2.0",
    "id": 1,
    "method": "initialize",
    "params": {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "try", "version": "1"}},
}


def main() -> int:
    """Run them all."""
    sound = str(Path(sys.argv[1]).resolve())
    tried("animate", "animate", sound, "-o", "speech.glb")
    tried("animate .npz", "animate", sound, "-o", "speech.npz")
    tried("export", "export", "speech.npz", "-o", "speech.vrma")
    tried("rig", "rig", "speech.glb", "-o", "body.json")
    tried("actions add", "actions", "add", "talk", "speech.glb")
    with served("serve", "--port", "0") as server:
        print("ok  serve", flush=True)
        tried("say", "say", sound, "--server", server, "-o", "said.npz")
        with served("proxy", "--upstream", "ws://127.0.0.1:9", "--avatar", server, "--port", "0") as proxy:
            print(f"ok  proxy at {proxy}")
        answer = subprocess.run(
            [*COMMAND, "mcp", "--server", server],
            input=json.dumps(INITIALIZE) + "\n",
            capture_output=True,
            text=True,
            timeout=60,
        )
        if '"serverInfo"' not in answer.stdout:
            raise SystemExit(f"mcp answered {answer.stdout!r}; {answer.stderr[-500:]}")
        print("ok  mcp")
    missing = subprocess.run([*COMMAND, "train", "--help"], capture_output=True, text=True)
    if missing.returncode != 1 or "echoavatar-lab" not in missing.stderr:
        raise SystemExit(f"`train` does not name echoavatar-lab: {missing.stderr!r}")
    print("ok  train says how to get the lab")
    return 0


def tried(what: str, *words: str) -> None:
    """Run a command that ends."""
    done = subprocess.run([*COMMAND, *words], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{what} failed: {(done.stdout + done.stderr)[-1500:]}")
    print(f"ok  {what}", flush=True)


@contextmanager
def served(*words: str) -> Iterator[str]:
    """A command that serves until stopped; yields the http address that it prints first."""
    with subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            address = next((word for word in line.split() if "://" in word), "")
            if not address:
                raise SystemExit(f"{words[0]} says {line!r} instead of an address")
            host = address.split("/")[2]
            reach(f"http://{host}/health")
            yield f"http://{host}"
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(20)
            process.kill()


def reach(address: str) -> None:
    """Wait until a server answers, be it that it has no such page."""
    until = time.monotonic() + WAIT_S
    while True:
        try:
            outgoing.opened(address, seconds=5).close()
            return
        except outgoing.OutgoingError as error:
            if error.status:
                return
        if time.monotonic() > until:
            raise SystemExit(f"{address} does not answer")
        time.sleep(0.5)


if __name__ == "__main__":
    sys.exit(main())
