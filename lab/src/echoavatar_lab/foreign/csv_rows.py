"""Tables of comma-separated values that come with datasets and recordings."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from echoavatar.errors import EchoAvatarError
from echoavatar.limits import read_text


def read_rows(
    path: Path, columns: Sequence[str] = (), *, error: type[EchoAvatarError] = EchoAvatarError
) -> list[dict[str, str]]:
    """The rows by the names in the first line; a cell that a short row lacks is empty.

    Raises EchoAvatarError: of the given kind; the file cannot be read, is no table, or lacks one of `columns`.
    """
    text = io.StringIO(read_text(path, "give a table of comma-separated values", error=error), newline="")
    table = csv.DictReader(text, restval="")
    try:
        rows = [{name: value for name, value in row.items() if name is not None} for row in table]
    except csv.Error as reason:
        raise error(f"{path} is no table of comma-separated values ({reason}); fetch it again") from reason
    if missing := [name for name in columns if name not in (table.fieldnames or ())]:
        raise error(f"{path} has no column {missing[0]!r}; its first line names the columns")
    return rows
