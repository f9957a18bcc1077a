import os
from pathlib import Path

import pytest

from echoavatar.errors import CheckpointError
from echoavatar.limits import check_file


def test_only_regular_files_of_a_bounded_size_pass(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(bytes(10))
    check_file(path, 10)
    with pytest.raises(CheckpointError, match="10 bytes, and at most 9"):
        check_file(path, 9, CheckpointError)
    with pytest.raises(CheckpointError, match="not a regular file"):
        check_file(tmp_path, 9, CheckpointError)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(CheckpointError, match="not a regular file"):
        check_file(tmp_path / "pipe", 9, CheckpointError)
    with pytest.raises(CheckpointError, match="cannot be read"):
        check_file(path / "below", 9, CheckpointError)
    with pytest.raises(FileNotFoundError):
        check_file(tmp_path / "none", 9)
