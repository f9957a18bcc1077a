"""Backups: every row and every clip of a studio in one ZIP, which can be restored into an empty store.

A backup is taken while the studio runs; one read transaction makes the rows consistent. The file fits either kind of
store, so it also moves a studio from SQLite to PostgreSQL. It holds all answers, and hashes of passwords and tokens:
protect it like the store.
"""

import json
import re
import shutil
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from sqlalchemy import func, insert, select, text
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object
from echoavatar.limits import check_file
from echoavatar.whole_file import whole_file

from .audit import note
from .secrecy import is_name
from .store import Store
from .tables import Clip, Login, Owner, Sound, Study, Table

_ROWS = "rows.jsonl"
_FORMAT = "echoavatar studio 1"
_ROW_BYTES = 1 << 24  # the longest row of a table
_ROWS_BYTES = 1 << 32
_ROWS_PACKED = 100  # most by which a ZIP may shrink the rows, if they have more than _ROWS_ALWAYS bytes
_ROWS_ALWAYS = 1 << 26
_BACKUP_BYTES = 1 << 40


def back_up(store: Store, media: Path, path: Path) -> dict[str, int]:
    """Write the ZIP, completely or not at all; return the number of rows of each table and the number of files."""
    counts: dict[str, int] = {}
    with whole_file(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as whole:
        with whole.open(_ROWS, "w") as out:
            out.write(json.dumps({"format": _FORMAT}).encode() + b"\n")
            with store.snapshot() as session:
                kept = {row.public for row in session.scalars(select(Study))}
                for table in Table.metadata.sorted_tables:
                    if table.name == Login.__tablename__:
                        continue  # sessions are valid only in the studio that opened them
                    for row in session.execute(select(table)).mappings():
                        counts[table.name] = counts.get(table.name, 0) + 1
                        out.write(json.dumps({"table": table.name, "row": dict(row)}).encode() + b"\n")
        files = [file for name in sorted(kept) for file in sorted((media / name).rglob("*")) if file.is_file()]
        for file in files:
            whole.write(file, f"media/{file.relative_to(media).as_posix()}", zipfile.ZIP_STORED)
    with store.write() as session:
        note(session, "studio", "backed up", detail=path.name)
    return counts | {"files": len(files)}


def restore(store: Store, media: Path, path: Path) -> dict[str, int]:
    """Put a backup into an empty store: all of it, or nothing.

    Raises:
        EchoAvatarError: the store is not empty, or the file is not a backup, is damaged, or does not fit on the disk.
    """
    with store.read() as session:
        if session.scalar(select(func.count(Owner.id))) or session.scalar(select(func.count(Study.id))):
            raise EchoAvatarError("this store is not empty; restore into a new --folder or --store")
    counts: dict[str, int] = {}
    unpacked: list[Path] = []
    try:
        check_file(path, _BACKUP_BYTES)
        with zipfile.ZipFile(path) as whole:
            _check_sizes(whole, media, path)
            if whole.testzip() is not None:
                raise EchoAvatarError(f"{path} is damaged; take another backup")
            with store.write() as session:
                _restore_rows(session, whole, counts, path)
                if not store.is_sqlite:
                    _go_on_counting(session)
                note(session, "studio", "restored", detail=path.name)
                for name in whole.namelist():
                    if name.startswith("media/"):
                        _unpack(whole, name, media, unpacked)
                        counts["files"] = len(unpacked)
    except BaseException as error:
        for file in unpacked:
            file.unlink(missing_ok=True)
            with suppress(OSError):  # the folder is not empty
                file.parent.rmdir()
        if not isinstance(error, _FOREIGN):
            raise
        reason = str(error).partition("\n")[0][:200]
        raise EchoAvatarError(f"{path} is not a backup of a studio ({reason})") from error
    return counts


_FOREIGN = (  # what readers of a damaged or forged ZIP raise
    OSError,
    RuntimeError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    zipfile.BadZipFile,
    zlib.error,
    SQLAlchemyError,
)


def _check_sizes(whole: zipfile.ZipFile, media: Path, path: Path) -> None:
    """Nothing may unpack to more than the ZIP itself holds, except rows, which are text and have a bound."""
    files = [entry for entry in whole.infolist() if entry.filename != _ROWS]
    for entry in files:
        if not _is_media(entry.filename):
            raise ValueError(f"a file named {entry.filename[:100]}")
        if entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size:
            raise ValueError(f"{entry.filename[:100]} is compressed, which no backup's media are")
    needed = sum(entry.file_size for entry in files)
    if needed > path.stat().st_size:
        raise ValueError("its files overlap")
    stored = whole.getinfo(_ROWS)
    rows = stored.file_size
    if rows > min(_ROWS_BYTES, max(_ROWS_ALWAYS, _ROWS_PACKED * stored.compress_size)):
        raise ValueError(f"{rows:,} bytes of rows, more than are read")
    free = shutil.disk_usage(media).free
    if needed + rows > free:
        raise EchoAvatarError(f"{path} needs {needed + rows:,} bytes and {free:,} are free; make room in {media}")


def _is_media(name: str) -> bool:
    parts = PurePosixPath(name).parts
    return len(parts) > 2 and parts[0] == "media" and is_name(parts[1]) and ".." not in parts and "\\" not in name


def _restore_rows(session: Session, whole: zipfile.ZipFile, counts: dict[str, int], path: Path) -> None:
    tables = {table.name: table for table in Table.metadata.sorted_tables}
    with whole.open(_ROWS) as lines:
        if read_object(lines.readline(_ROW_BYTES), str(path)).get("format") != _FORMAT:
            raise EchoAvatarError(f"{path} was written by another version of the studio")
        while line := lines.readline(_ROW_BYTES):
            if len(line) >= _ROW_BYTES:
                raise ValueError(f"a row of {_ROW_BYTES:,} bytes or more")
            stored = read_object(line, str(path))
            _check_row(stored["table"], stored["row"])
            session.execute(insert(tables[stored["table"]]).values(**stored["row"]))
            counts[stored["table"]] = counts.get(stored["table"], 0) + 1


def _go_on_counting(session: Session) -> None:
    """Let PostgreSQL number new rows after the restored ones."""
    for table in Table.metadata.sorted_tables:
        session.execute(
            text(
                f"SELECT setval(pg_get_serial_sequence('{table.name}', 'id'),"
                f" COALESCE((SELECT MAX(id) FROM {table.name}), 0) + 1, false)"
            )
        )


def _check_row(table: str, row: dict[str, Any]) -> None:
    """Names and paths become paths on this disk, so they must be such as the studio itself makes."""
    if table == Study.__tablename__ and not is_name(row["public"]):
        raise ValueError(f"a study named {str(row['public'])[:40]!r}")
    if table in (Sound.__tablename__, Clip.__tablename__):
        study, _, file = row["path"].partition("/")
        if not is_name(study) or not re.fullmatch(r"[0-9x-]+\.(flac|motion)", file):
            raise ValueError(f"a file named {row['path'][:100]!r}")


def _unpack(whole: zipfile.ZipFile, name: str, media: Path, unpacked: list[Path]) -> None:
    parts = PurePosixPath(name).parts[1:]
    target = media.joinpath(*parts)
    if not target.resolve().is_relative_to(media.resolve()):
        raise ValueError(f"a file named {name}")
    target.parent.mkdir(parents=True, exist_ok=True)
    unpacked.append(target)
    with whole.open(name) as source, target.open("wb") as out:
        shutil.copyfileobj(source, out)
