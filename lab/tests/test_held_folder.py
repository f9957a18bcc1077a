"""One run holds a folder; the system frees it when the run dies; a disk that is full or read-only is one line."""

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from lab.tests.training.line import Line

from echoavatar.cli import main
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.stored import read_card, read_config
from echoavatar_lab import checkpoint, held_folder
from echoavatar_lab.corpora.rehearsal.corpus import Plan, rehearse
from echoavatar_lab.held_folder import FILE, hold_folder
from echoavatar_lab.training import train
from echoavatar_lab.training.processes import Processes
from echoavatar_lab.training.run import _alone_in

HOLD = "import sys, time; from pathlib import Path; from echoavatar_lab.held_folder import hold_folder\n"
HOLD += "with hold_folder(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"


@pytest.fixture
def other_run(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that holds the folder."""
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_a_second_run_is_told_who_holds_the_folder_and_death_frees_it(
    tmp_path: Path, other_run: subprocess.Popen[str]
) -> None:
    with pytest.raises(EchoAvatarError) as refused:
        train(Line(), tmp_path)
    words = str(refused.value)
    assert f"{tmp_path} is in use by process {other_run.pid} on " in words
    assert " since 20" in words
    assert words.endswith("; wait for it, stop it, or choose another folder")
    assert [path.name for path in tmp_path.iterdir()] == [FILE], "the second run wrote nothing"
    other_run.kill()
    other_run.wait()
    train(Line(), tmp_path)
    assert not (tmp_path / FILE).exists()


def test_a_run_may_hold_its_folder_twice_but_not_another_thread(tmp_path: Path) -> None:
    refusals = []

    def enter() -> None:
        try:
            with hold_folder(tmp_path):
                pass
        except EchoAvatarError as error:
            refusals.append(str(error))

    with hold_folder(tmp_path), hold_folder(tmp_path / "."):
        thread = threading.Thread(target=enter)
        thread.start()
        thread.join()
    assert f"is in use by process {os.getpid()}" in refusals[0]
    with hold_folder(tmp_path):
        pass


def test_the_folder_is_free_after_an_error(tmp_path: Path) -> None:
    for _ in range(2):
        with pytest.raises(KeyError), hold_folder(tmp_path):
            raise KeyError
    assert not list(tmp_path.iterdir())


def test_what_a_killed_run_left_half_written_is_removed_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    for name in (".0123456789abcdef.partial", "clips/.fedcba9876543210.partial", "clips/mine.partial", "a.npz"):
        (tmp_path / name).write_bytes(b"x")
    with hold_folder(tmp_path):
        assert sorted(p.name for p in tmp_path.rglob("*") if p.is_file()) == [FILE, "a.npz", "mine.partial"]


def test_the_note_of_the_holder_may_be_anything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for note, said in (
        (b"[" * 9000, "another run"),
        (b"", "another run"),
        (json.dumps({"pid": 1, "host": "\x1b[2J\n", "since": "?", "command": "x" * 9}).encode(), r"on \?\[2J\? since"),
    ):
        with hold_folder(tmp_path):
            (tmp_path / FILE).write_bytes(note)
            monkeypatch.setattr(held_folder, "_held", set())
            with pytest.raises(EchoAvatarError, match=said), hold_folder(tmp_path):
                pass


@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_a_lock_that_is_no_file_is_refused_and_not_followed(tmp_path: Path, kind: str) -> None:
    victim, folder = tmp_path / "victim", tmp_path / "run"
    victim.write_text("mine")
    folder.mkdir()
    if kind == "link":
        (folder / FILE).symlink_to(victim)
    elif kind == "pipe":
        os.mkfifo(folder / FILE)
    else:
        (folder / FILE).mkdir()
    with pytest.raises(EchoAvatarError, match=FILE), hold_folder(folder):
        pass
    assert victim.read_text() == "mine"


class _Two(Processes):
    """One of two processes of a run, where the first was told `refusal`."""

    def __init__(self, rank: int, refusal: str = "") -> None:
        super().__init__()
        self.rank, self.refusal = rank, refusal

    def gather_json(self, value: str) -> list[str]:
        return [value or self.refusal, ""]


def test_of_several_processes_the_first_holds_the_folder_and_a_refusal_ends_all(tmp_path: Path) -> None:
    with _alone_in(tmp_path, _Two(0)), _alone_in(tmp_path, _Two(1)):
        assert (tmp_path / FILE).exists()
    with pytest.raises(EchoAvatarError, match="in use"), _alone_in(tmp_path, _Two(1, "it is in use")):
        pass


def test_where_the_file_system_has_no_locks_a_run_is_warned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def no_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", no_locks)
    with hold_folder(tmp_path):
        pass
    assert "no locks" in caplog.text


# ---- disks


class _Disk:
    """Fails at the nth call of one of the system's functions that write, and works before."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, call: str, number: int, code: int) -> None:
        self.calls = 0
        whole = getattr(os, call)

        def failing(*args: object, **how: object) -> object:
            self.calls += 1
            if self.calls >= number:
                raise OSError(code, os.strerror(code))
            return whole(*args, **how)

        monkeypatch.setattr(os, call, failing)


@pytest.mark.parametrize(
    ("number", "code"),
    [(1, errno.ENOSPC), (2, errno.EROFS), (3, errno.EDQUOT), (4, errno.EIO), (6, errno.EFBIG), (8, errno.ENOSPC)],
)
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_failing_disk_ends_training_in_one_line_and_the_run_goes_on_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, number: int, code: int
) -> None:
    """At every flush and rename of the second checkpoint in turn."""
    train(Line(), tmp_path, minutes=0)
    with monkeypatch.context() as patch:
        disk = _Disk(patch, call, number, code)
        with pytest.raises(EchoAvatarError, match=r"^cannot write .*MB free\); make room .* run it again$") as told:
            train(Line(), tmp_path)
        assert disk.calls == number
    assert str(tmp_path) in str(told.value)
    assert os.strerror(code) in str(told.value)
    assert not list(tmp_path.glob("*.partial"))
    checkpoint.read_weights(tmp_path)
    read_config(tmp_path, type(Line().config))
    train(Line(), tmp_path)
    assert read_card(tmp_path)["step"] == 12


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 KiB."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", place], capture_output=True)
    if mounted.returncode:
        pytest.skip("only root may mount here")
    yield place
    subprocess.run(["umount", place], check=True)


def test_a_full_disk_ends_training_in_one_line_and_the_run_goes_on_later(small_disk: Path) -> None:
    folder, filler = small_disk / "run", small_disk / "filler"
    train(Line(), folder, minutes=0)
    for spare in range(0, 12_000, 1000):
        filler.write_bytes(b"x" * max(0, _free(small_disk) - spare))
        with pytest.raises(EchoAvatarError, match=r"^cannot write .*; 0 MB free\); make room"):
            train(Line(), folder)
        checkpoint.read_weights(folder)
        filler.unlink()
    train(Line(), folder)
    assert read_card(folder)["step"] == 12


def test_a_disk_that_becomes_read_only_ends_training_in_one_line(small_disk: Path) -> None:
    train(Line(), small_disk / "run", minutes=0)
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    with pytest.raises(EchoAvatarError, match=r"^cannot write .*Read-only file system"):
        train(Line(), small_disk / "run")
    with pytest.raises(CheckpointError, match=r"^cannot write .*Read-only file system"):
        checkpoint.save(small_disk / "new", config=Line().config, weights={}, card={})


def test_a_corpus_on_a_full_disk_is_one_line_and_goes_on_later(small_disk: Path) -> None:
    plan, filler = Plan(hours=0.002, seed=0, folder=small_disk / "corpus", clip_seconds=3.6), small_disk / "filler"
    filler.write_bytes(b"x" * 40_000)
    with pytest.raises(EchoAvatarError, match=r"^cannot write .*corpus.* MB free\); make room"):
        rehearse(plan)
    assert not list(small_disk.rglob("*.npz"))
    filler.unlink()
    subprocess.run(["mount", "-o", "remount,size=8m", small_disk], check=True)
    assert rehearse(plan) == 2


def test_any_command_tells_a_full_disk_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def fill(_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "out.bin"))

    monkeypatch.setattr("echoavatar.cli.doctor.run", fill)
    assert main(["doctor"]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"echoavatar: cannot write {tmp_path / 'out.bin'} (No space left on device; ")
    assert said.count("\n") == 1


def _free(place: Path) -> int:
    found = os.statvfs(place)
    return found.f_bavail * found.f_frsize


KILLED = "import sys; from pathlib import Path; from lab.tests.training.line import CONFIG, Line\n"
KILLED += "from echoavatar_lab.training import train\n"
KILLED += "train(Line(CONFIG.model_copy(update={'steps': 4000, 'save_every': 1})), Path(sys.argv[1]), minutes=0.5)"


@pytest.mark.slow
def test_a_run_killed_at_any_moment_leaves_a_checkpoint_that_loads_and_goes_on(tmp_path: Path) -> None:
    """Killed 12 times, at moments that move through the writing of a checkpoint."""
    reached = 0
    for number in range(12):
        process = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)])
        until = time.monotonic() + 60
        while not _has_moved(tmp_path, reached) and time.monotonic() < until:
            time.sleep(0.005)
        time.sleep(0.0037 * number)
        process.send_signal(signal.SIGKILL)
        process.wait()
        checkpoint.read_weights(tmp_path)
        read_config(tmp_path, type(Line().config))
        step = int(str(read_card(tmp_path)["step"]))
        assert step > reached
        reached = step
    steps = [json.loads(line)["step"] for line in (tmp_path / "metrics.jsonl").read_text().splitlines()[:-1]]
    assert steps == sorted(set(steps))


def _has_moved(folder: Path, reached: int) -> bool:
    try:
        return int(str(read_card(folder).get("step", 0))) > reached
    except EchoAvatarError:
        return False
