import os
from pathlib import Path

import pytest

from echoavatar.errors import AudioError
from echoavatar_lab.foreign.csv_rows import read_rows


def test_rows_are_read_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text('\ufeffa,b\n1,"x\ny"\n2\n3,z,more\n', "utf-8")
    assert read_rows(tmp_path / "a.csv", ("a",)) == [{"a": "1", "b": "x\ny"}, {"a": "2", "b": ""}, {"a": "3", "b": "z"}]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"b\n1\n", "no column 'a'"),
        (b"", "no column 'a'"),
        (b"a\n\xff\n", "cannot be read"),
        (b"a\n" + b"x" * 200_000, "no table"),
    ],
)
def test_what_is_no_table_is_one_error(tmp_path: Path, data: bytes, said: str) -> None:
    (tmp_path / "a.csv").write_bytes(data)
    with pytest.raises(AudioError, match=said):
        read_rows(tmp_path / "a.csv", ("a",), error=AudioError)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(AudioError, match="not a regular file"):
        read_rows(tmp_path / "pipe", error=AudioError)
