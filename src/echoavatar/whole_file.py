"""Files are written completely or not at all. Uses only `errors`."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import EchoAvatarError


@contextmanager
def whole_file(
    path: Path | str,
    *,
    error: type[EchoAvatarError] = EchoAvatarError,
    failures: tuple[type[Exception], ...] = (),
    is_flushed: bool = False,
) -> Iterator[Path]:
    """Give a path beside `path` to write to; the file there replaces `path` when the block ends without an error.

    Args:
        path: the file; an older one stays until the new one is complete.
        error: what a failure to write becomes.
        failures: what the block's own writer raises, besides OSError, when it cannot write.
        is_flushed: flush the file to the disk before it replaces the old one, so that a power cut leaves one of them.
            This takes some 15 ms, so thousands of small files go without.

    Raises:
        EchoAvatarError: of the kind `error`; the file cannot be written.
    """
    unwritable: tuple[type[Exception], ...] = (OSError, *failures)
    partial = Path(f"{path}.{os.getpid()}.partial")  # two processes may write the same file
    try:
        yield partial
        if is_flushed:
            _flush(partial, os.O_RDWR)
        partial.replace(path)
        if is_flushed and os.name == "posix":  # other systems do not open folders
            _flush(partial.parent, os.O_RDONLY)
    except unwritable as reason:
        cause = getattr(reason, "strerror", None) or reason
        raise error(f"cannot write {path} ({cause}); free space or choose another place") from reason
    finally:
        with suppress(OSError):
            partial.unlink()


def write_whole(
    path: Path | str, data: bytes | str, *, error: type[EchoAvatarError] = EchoAvatarError, is_flushed: bool = False
) -> None:
    """Write bytes, or text as UTF-8, completely or not at all.

    Raises:
        EchoAvatarError: of the kind `error`; the file cannot be written.
    """
    with whole_file(path, error=error, is_flushed=is_flushed) as partial:
        partial.write_bytes(data.encode() if isinstance(data, str) else data)


def make_output_folder(folder: Path) -> None:
    """Make a folder for the output of a command, with the folders above it; it may exist.

    Raises:
        EchoAvatarError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchoAvatarError(f"cannot write to {folder}: {error.strerror}; choose another -o") from error


def _flush(path: Path, mode: int) -> None:
    opened = os.open(path, mode)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)
