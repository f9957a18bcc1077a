"""Write files completely or not at all, and report a full or read-only disk in one line. Uses only `errors`."""

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import EchoAvatarError

_DISK_FAILS = {errno.ENOSPC, errno.EROFS, errno.EFBIG, errno.EIO, getattr(errno, "EDQUOT", errno.ENOSPC)}


@contextmanager
def whole_file(
    path: Path | str,
    *,
    error: type[EchoAvatarError] = EchoAvatarError,
    failures: tuple[type[Exception], ...] = (),
    is_flushed: bool = False,
) -> Iterator[Path]:
    """Give a temporary file in the folder of `path`; it replaces `path` when the block ends without an error.

    The temporary file is new, empty and has a random name, so that nobody can put a link in its place.

    Args:
        path: the file; an older one stays until the new one is complete.
        error: the class of the error that a failure to write raises.
        failures: what the block's own writer raises, besides OSError, when it cannot write.
        is_flushed: flush the file to the disk before it replaces the old one, so that a power cut leaves one of them.
            This takes some 15 ms, which is too long for thousands of small files.

    Raises:
        EchoAvatarError: of the kind `error`; the file cannot be written, or `path` is a pipe, a device or a folder.
    """
    unwritable: tuple[type[Exception], ...] = (OSError, *failures)
    partial = Path(path).parent / f".{secrets.token_hex(8)}.partial"
    try:
        if os.path.exists(path) and not os.path.isfile(path):
            raise OSError(errno.EINVAL, "it is no regular file")
        os.close(os.open(partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield partial
        if is_flushed:
            _flush(partial, os.O_RDWR)
        partial.replace(path)
        if is_flushed and os.name == "posix":  # other systems do not open folders
            _flush(partial.parent, os.O_RDONLY)
    except unwritable as reason:
        raise write_error(path, reason, error) from reason
    finally:
        with suppress(OSError):
            partial.unlink()


def write_whole(
    path: Path | str, data: bytes | str, *, error: type[EchoAvatarError] = EchoAvatarError, is_flushed: bool = False
) -> None:
    """Write bytes, or text as UTF-8, completely or not at all.

    Raises EchoAvatarError: of the kind `error`; the file cannot be written.
    """
    with whole_file(path, error=error, is_flushed=is_flushed) as partial:
        partial.write_bytes(data.encode() if isinstance(data, str) else data)


def make_output_folder(folder: Path, *, error: type[EchoAvatarError] = EchoAvatarError) -> None:
    """Make a folder for the output of a command, with the folders above it; it may exist.

    Raises EchoAvatarError: of the kind `error`; it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        raise write_error(folder, reason, error) from reason


@contextmanager
def disk_errors(place: Path | str) -> Iterator[None]:
    """A context in which a full, read-only or broken disk raises an error of one line; other errors pass unchanged.

    Args:
        place: what is written, for failures that name no file.

    Raises:
        EchoAvatarError: the disk takes nothing more.
    """
    try:
        yield
    except OSError as reason:
        if reason.errno not in _DISK_FAILS:
            raise
        raise write_error(reason.filename or place, reason) from reason


def write_error(path: Path | str, reason: Exception, error: type[EchoAvatarError] = EchoAvatarError) -> EchoAvatarError:
    """The error of a file or folder that cannot be written: the path, the cause, the free space and the remedy."""
    cause = getattr(reason, "strerror", None) or reason
    with suppress(OSError, ValueError):
        there = next(place for place in Path(path).absolute().parents if place.is_dir())
        cause = f"{cause}; {shutil.disk_usage(there).free / 1e6:,.0f} MB free"
    return error(f"cannot write {path} ({cause}); make room or choose another place, and run it again")


def _flush(path: Path, mode: int) -> None:
    opened = os.open(path, mode)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)
