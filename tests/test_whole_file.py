"""A file is there completely or not at all, and a failure is told in one line."""

import os
import secrets
from pathlib import Path

import pytest
import torch

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.whole_file import whole_file, write_whole
from echoavatar_lab import checkpoint


@pytest.mark.parametrize("is_flushed", [False, True])
def test_the_old_file_stays_until_the_new_one_is_complete(tmp_path: Path, is_flushed: bool) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with whole_file(path, is_flushed=is_flushed) as partial:
        partial.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_in_the_block_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(KeyError), whole_file(path) as partial:
        {}[partial.write_text("half")]
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_text_is_utf_8_with_the_line_ends_given(tmp_path: Path) -> None:
    write_whole(tmp_path / "a", "ä\n")
    write_whole(str(tmp_path / "b"), b"\x00\r\n")
    assert (tmp_path / "a").read_bytes() == b"\xc3\xa4\n"
    assert (tmp_path / "b").read_bytes() == b"\x00\r\n"


@pytest.mark.parametrize("name", ["nowhere/a.txt", "file/a.txt", "folder", "folder/..", "pipe", "zero"])
def test_a_place_that_cannot_be_written_is_told_in_one_line(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    said = rf"^cannot write .*{name} \([^()]+; [0-9,]+ MB free\); make room or choose another place, and run it again$"
    with pytest.raises(MotionError, match=said):
        write_whole(tmp_path / name, b"", error=MotionError)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "folder", "pipe", "zero"]
    assert (tmp_path / "pipe").is_fifo()


def test_the_longest_name_of_a_file_is_one(tmp_path: Path) -> None:
    write_whole(tmp_path / ("a" * 255), "long")
    assert (tmp_path / ("a" * 255)).read_text() == "long"


def test_nobody_can_put_a_link_where_the_new_file_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with whole_file(tmp_path / "a") as one, whole_file(tmp_path / "a") as other:
        assert {len(place.name) for place in (one, other)} == {len(one.name)} == {25}
        assert one != other  # 64 random bits
    (tmp_path / "victim").write_text("kept")
    monkeypatch.setattr(secrets, "token_hex", lambda _: "0")
    (tmp_path / ".0.partial").symlink_to(tmp_path / "victim")
    with pytest.raises(EchoAvatarError, match="File exists"):
        write_whole(tmp_path / "b", "overwritten")
    assert (tmp_path / "victim").read_text() == "kept"


def test_what_the_writer_raises_is_told_too(tmp_path: Path) -> None:
    with (
        pytest.raises(EchoAvatarError, match=r"cannot write .*a \(no such codec; "),
        whole_file(tmp_path / "a", failures=(RuntimeError,)),
    ):
        raise RuntimeError("no such codec")


def test_a_flushed_file_reaches_the_disk_before_it_replaces_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, seen = tmp_path / "a", []
    path.write_text("old")
    monkeypatch.setattr(os, "fsync", lambda _: seen.append(path.read_text()))
    write_whole(path, "new", is_flushed=True)
    assert seen == ["old", "new"]  # the file, then its folder


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="names of open files are read from /proc")
def test_every_file_of_a_checkpoint_is_flushed_renamed_and_its_folder_flushed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[str, str]] = []
    flush, replace = os.fsync, os.replace

    def noted_flush(opened: int) -> None:
        calls.append(("flush", Path(f"/proc/self/fd/{opened}").readlink().name))
        flush(opened)

    def noted_replace(old: Path, new: Path) -> None:
        calls.append(("rename", Path(new).name))
        replace(old, new)

    monkeypatch.setattr(os, "fsync", noted_flush)
    monkeypatch.setattr(os, "replace", noted_replace)
    monkeypatch.setattr(secrets, "token_hex", lambda _: "0")
    checkpoint.save(tmp_path, config=Config(), weights={"a": torch.zeros(1)}, card={})
    names = ("model.safetensors", "config.json", "card.json")
    wanted = [(("flush", ".0.partial"), ("rename", name), ("flush", tmp_path.name)) for name in names]
    assert calls == [call for file in wanted for call in file]
