import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from echoavatar import limits
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.json_reader import read_object_file
from echoavatar.limits import BVH_BYTES, CONFIG_BYTES, GLB_BYTES, check_file, read_text
from echoavatar.motion.formats.bvh import read_bvh
from echoavatar.motion.formats.gltf_rig import read_gltf_rig
from echoavatar.stored import read_card


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


@pytest.mark.parametrize(
    ("name", "most", "read"),
    [
        ("card.json", CONFIG_BYTES, lambda path: read_card(path.parent)),
        ("a.bvh", BVH_BYTES, read_bvh),
        ("a.glb", GLB_BYTES, read_gltf_rig),
    ],
)
def test_files_beyond_their_limit_are_refused_unread(
    tmp_path: Path, name: str, most: int, read: Callable[[Path], object]
) -> None:
    with (tmp_path / name).open("wb") as file:
        file.truncate(most + 1)
    with pytest.raises(EchoAvatarError, match=f"at most {most:,} are read"):
        read(tmp_path / name)


def test_text_is_read_from_regular_files_of_utf_8(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"\xef\xbb\xbfwords")
    assert read_text(path, "write it") == "words"
    path.write_bytes(b"\xff")
    os.mkfifo(tmp_path / "pipe")
    for wrong, said in ((path, "utf-8"), (tmp_path / "none", "No such file"), (tmp_path / ("a" * 5_000), "too long")):
        with pytest.raises(CheckpointError, match=f"cannot be read .*{said}"):
            read_text(wrong, "write it", error=CheckpointError)
    with pytest.raises(CheckpointError, match="not a regular file"):
        read_text(tmp_path / "pipe", "write it", error=CheckpointError)


def to_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def to_more(path: Path) -> None:
    path.write_bytes(bytes(1_000))


def to_zeros(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("change", [to_pipe, to_more, to_zeros])
def test_a_file_that_is_exchanged_after_the_check_is_refused_too(
    change: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def check_and_change(path: Path, *rest: Any) -> None:
        check_file(path, *rest)
        change(path)

    monkeypatch.setattr(limits, "check_file", check_and_change)
    path = tmp_path / "a"
    path.write_bytes(b"{}")
    with pytest.raises(EchoAvatarError, match=r"not a regular file|1,000 bytes, and at most 999"):
        read_object_file(path, most=999)
