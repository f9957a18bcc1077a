"""A download that was made to do harm: one line for each problem, in little time and memory, and nothing is written."""

import json
import os
import re
import shutil
import struct
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar.cli import main
from echoavatar.errors import CheckpointError
from echoavatar_lab.foreign.foreign_files import read_tensors


def written(path: Path, data: bytes) -> None:
    """Write a file of the copy, which is linked to the download's."""
    path.unlink(missing_ok=True)
    path.write_bytes(data)


def weights_of(root: Path) -> Path:
    return next(root.glob("ckpts/body_g_d/*.safetensors"))


def tokenizer_of(root: Path) -> Path:
    return next(root.glob("ckpts/body_rvqvae/*lower*/net_*.pth"))


def safetensors(root: Path, shapes: dict[str, list[int]], data: bytes = b"") -> None:
    entries = {key: {"dtype": "F32", "shape": shape, "data_offsets": [0, len(data)]} for key, shape in shapes.items()}
    header = json.dumps(entries).encode()
    written(weights_of(root).with_name("more.safetensors"), struct.pack("<Q", len(header)) + header + data)


def pickled(root: Path, table: bytes) -> None:
    path = tokenizer_of(root)
    path.unlink()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr("archive/data.pkl", table)
        archive.writestr("archive/version", "3\n")


def hash_bomb() -> bytes:
    """A key of tuples that hold the one before twice, sixty deep: its hash takes 2^60 steps."""
    made = b"\x80\x02K\x01q\x01"
    for depth in range(1, 60):
        made += b"h" + bytes([depth]) + b"h" + bytes([depth]) + b"\x86q" + bytes([depth + 1])
    return made + b"}h\x3cK\x01s."


def config(root: Path, **changes: object) -> None:
    path = weights_of(root).with_name("config.json")
    written(path, json.dumps(json.loads(path.read_text()) | changes).encode())


def codec(root: Path, **changes: object) -> None:
    path = root / "encodec/config.json"
    written(path, json.dumps(json.loads(path.read_text()) | changes).encode())


def pipe(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def skeleton(root: Path, **changes: np.ndarray) -> None:
    path = root / "stats/zm_meta_info.npz"
    stored = dict(np.load(path)) | changes
    path.unlink()
    np.savez_compressed(path, **stored)


def renamed(root: Path, codes: str) -> None:
    folder = tokenizer_of(root).parent
    folder.rename(folder.with_name(f"x_bp_lower_nb-code_{codes}"))


class _Code:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("touch ran",)


def pickled_codec(root: Path) -> None:
    next(root.glob("encodec/*.safetensors")).unlink()
    torch.save({"a": _Code()}, root / "encodec/pytorch_model.bin")


ATTACKS: dict[str, tuple[Callable[[Path], None], str]] = {
    "weights that are a pipe": (lambda root: pipe(weights_of(root)), "not a regular file"),
    "weights that are a link to a device": (lambda root: linked(weights_of(root)), "not a regular file"),
    "a tensor without axes": (lambda root: safetensors(root, {"a": []}, b"0000"), "is no matrix or vector"),
    "a tensor of an absurd shape": (lambda root: safetensors(root, {"a": [2**62, 0]}), "is no matrix or vector"),
    "30,000 tensors": (lambda root: safetensors(root, {f"t{n}": [0] for n in range(30_000)}), "30,000 tensors"),
    "280,000 tensors": (lambda root: safetensors(root, {f"t{n}": [0] for n in range(280_000)}), "list of tensors of"),
    "names a terminal obeys": (lambda root: safetensors(root, {"\x1b[2J\n../a": [1]}, b"0000"), r"\\x1b\[2J ../a"),
    "a list of lists": (lambda root: pickled(root, b"\x80\x02" + b"]" * 2_000_000 + b"."), "more steps than weights"),
    "a hash that never ends": (lambda root: pickled(root, hash_bomb()), "tuples deeper than weights need"),
    "an endless table": (lambda root: pickled(root, bytes(65 << 20)), "larger than any model's"),
    "a billion layers": (lambda root: config(root, num_hidden_layers=10**9), "1000000000 layers of"),
    "wide layers": (lambda root: config(root, hidden_size=10**12), "holds what no release holds"),
    "wider layers": (lambda root: config(root, intermediate_size=10**30), "holds what no release holds"),
    "no codes": (lambda root: renamed(root, "0"), "holds what no release holds"),
    "more codes than numbers": (lambda root: renamed(root, "9" * 30), "holds what no release holds"),
    "joints after infinity": (lambda root: skeleton(root, parents=np.full(88, np.inf)), "cannot convert float inf"),
    "joints below none": (lambda root: skeleton(root, parents=np.full(88, 2**62)), "holds what no release holds"),
    "offsets of text": (lambda root: skeleton(root, offsets=np.full((88, 3), "a")), "of other kinds"),
    "one name": (lambda root: skeleton(root, names=np.array("a")), "of other kinds"),
    "an npz bomb": (lambda root: skeleton(root, more=np.zeros(1 << 27, np.uint8)), "67,108,864 are read"),
    "a codec as a pipe": (lambda root: pipe(root / "encodec/config.json"), "not a regular file"),
    "a codec that runs": (pickled_codec, "would run posix.system"),
    "a codec of a billion layers": (lambda root: codec(root, num_lstm_layers=10**9), "more parameters than"),
    "a codec of wide layers": (lambda root: codec(root, num_filters=10**9), "more numbers than"),
    "a codec of endless codes": (lambda root: codec(root, target_bandwidths=[1e9]), "more modules than"),
    "a codec of text": (lambda root: codec(root, hidden_size="x"), "neither a folder with an EnCodec"),
    "a nested codec": (lambda root: written(root / "encodec/config.json", b"[" * 100_000), "is not JSON"),
}  # what is done to the download, what is said


def linked(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


@pytest.fixture
def root(download: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy whose files are linked to the download's."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(download, tmp_path / "copy", copy_function=lambda a, b: Path(b).hardlink_to(a))
    return tmp_path / "copy"


def said_of(root: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    words = ["import", "reference", "--ckpts", str(root / "ckpts"), "--stats", str(root / "stats")]
    code = main([*words, "--codec", str(root / "encodec"), "-o", str(root / "out")])
    told = capsys.readouterr()
    return code, told.err


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_hostile_download_is_refused_in_a_few_lines(
    root: Path, attack: str, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil, words = ATTACKS[attack]
    spoil(root)
    began = time.monotonic()
    code, told = said_of(root, capsys)
    assert code == 1
    assert time.monotonic() - began < 20, "5 s on an idle machine"
    lines = [line for line in told.splitlines() if line.startswith(("problem: ", "echoavatar: "))]
    assert 1 <= len(lines) <= 12
    assert any(re.search(words, line) for line in lines), told
    assert all(line.isprintable() for line in lines)
    assert not (root / "out").exists()
    assert not Path("ran").exists()


def test_scripts_that_are_no_files_hold_nothing_up(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipe(root / "scripts/zzy.py")
    (root / "scripts/zzx.py").symlink_to("/dev/zero")
    (root / "scripts/zzw.py").mkdir()
    assert said_of(root, capsys)[0] == 0


def test_of_a_thousand_problems_the_first_are_told(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    header = {f"t{n}": {"dtype": "F32", "shape": [1], "data_offsets": [4 * n, 4 * n + 4]} for n in range(1000)}
    packed = json.dumps(header).encode()
    written(
        weights_of(root).with_name("more.safetensors"), struct.pack("<Q", len(packed)) + packed + bytes(4 * len(header))
    )
    _, told = said_of(root, capsys)
    assert told.count("problem: ") == 500
    assert "1000 problems, the first 500 of them above; nothing was written" in told


def test_the_table_of_an_honest_file_is_followed(tmp_path: Path) -> None:
    """Weights, an optimiser's state and settings in tuples, shared and not."""
    shared = (1, (2, 3))
    layer = torch.nn.Linear(2, 3)
    optimiser = torch.optim.AdamW(layer.parameters())
    layer(torch.zeros(1, 2)).sum().backward()
    optimiser.step()
    stored = {"net": layer.state_dict(), "optimiser": optimiser.state_dict(), "how": [shared, shared, (), "a"]}
    torch.save(stored, tmp_path / "a.pth")
    assert set(read_tensors(tmp_path / "a.pth", "net")) == {"weight", "bias"}


def test_tensors_that_are_empty_complex_or_no_numbers_are_refused(tmp_path: Path) -> None:
    nan, infinite = torch.full((2,), torch.nan, dtype=torch.float64), torch.tensor([1.0, torch.inf]).half()
    for value in (torch.empty(2**40, 0), torch.zeros(2, dtype=torch.complex64), nan, infinite):
        torch.save({"net": {"a": value}}, tmp_path / "a.pth")
        with pytest.raises(CheckpointError, match="a holds (no numbers|what is no number)"):
            read_tensors(tmp_path / "a.pth", "net")
