"""One run at a time writes to a folder: a lock that names its holder and that the system frees when the holder dies.

Everything that resumes in a folder holds it: training, alignment, corpora, tokens, tables. The lock is on the file
`.running` in the folder, which goes when the run ends; after a crash it stays and locks nobody out. Uses `echoavatar`
only.
"""

import json
import logging
import os
import re
import shlex
import socket
import stat
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object
from echoavatar.whole_file import disk_errors, make_output_folder, write_error

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

FILE = ".running"
_LOG = logging.getLogger(__name__)
_MOST_BYTES = 4096  # of the file
_LOCKED_BYTE = 1 << 20  # Windows locks bytes, which nobody may read then: one behind the text
_LEFT_OVER = re.compile(r"\.[0-9a-f]{16}\.partial")  # what `whole_file` was writing when a run was killed
_held: set[tuple[Path, int]] = set()  # folders, each with the thread that holds it


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Make a folder and keep other runs out of it; parts of this run may hold it again, in the same thread.

    Files that a killed run left half written are removed. Raises EchoAvatarError if another run holds it, or the disk
    is full or read-only, now or while it is held.
    """
    key = (folder.resolve(), threading.get_ident())
    if key in _held:
        yield
        return
    make_output_folder(folder)
    path = folder / FILE
    with disk_errors(folder):
        handle = _locked(path)
        try:
            _sign(handle)
            _held.add(key)
            for place in (*folder.glob("*.partial"), *folder.glob("*/*.partial")):
                if _LEFT_OVER.fullmatch(place.name):
                    place.unlink(missing_ok=True)
            yield
        finally:
            _held.discard(key)
            with suppress(OSError):  # Windows keeps a file that is open
                path.unlink()
            os.close(handle)


def _locked(path: Path) -> int:
    """An open, locked file at `path`."""
    while True:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        except OSError as reason:
            raise write_error(path, reason) from reason
        try:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise EchoAvatarError(f"{path} is not a regular file; remove it, and run it again")
            _lock(handle, path)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), path.stat()):
                    return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)  # the holder before us removed it after we had opened it


def _lock(handle: int, path: Path) -> None:
    try:
        if sys.platform == "win32":
            os.lseek(handle, _LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError) as reason:
        raise EchoAvatarError(
            f"{path.parent} is in use by {_holder(handle)}; wait for it, stop it, or choose another folder"
        ) from reason
    except OSError as reason:
        _LOG.warning("%s: this file system has no locks (%s); see that no other run uses it", path.parent, reason)


def _sign(handle: int) -> None:
    """Write who holds the lock."""
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])[:400]
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    told = {"pid": os.getpid(), "host": socket.gethostname(), "since": since, "command": command}
    os.ftruncate(handle, 0)
    os.lseek(handle, 0, os.SEEK_SET)
    os.write(handle, json.dumps(told).encode())


def _holder(handle: int) -> str:
    """Who holds the lock, as far as the file says."""
    try:
        os.lseek(handle, 0, os.SEEK_SET)
        told = read_object(os.read(handle, _MOST_BYTES), FILE)
        said = "process {pid} on {host} since {since} ({command})".format_map(told)
    except (OSError, EchoAvatarError, KeyError):
        return "another run"
    return "".join(sign if sign.isprintable() else "?" for sign in said)
