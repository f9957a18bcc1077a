"""Files of somebody else's: what is no tensor is never run, and what is broken is named."""

import os
import pickle  # noqa: TID251  # to make what must be refused
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.limits import PICKLED_BYTES
from echoavatar_lab.foreign import foreign_files
from echoavatar_lab.foreign.foreign_files import (
    read_array,
    read_arrays,
    read_matrices,
    read_pickled_array,
    read_table,
    read_tensors,
)


class Bomb:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_tensors_come_back_and_the_rest_of_the_file_does_not_matter(tmp_path):
    torch.save({"net": {"a": torch.arange(3)}, "total_it": 5}, tmp_path / "net.pth")
    assert read_tensors(tmp_path / "net.pth", "net")["a"].tolist() == [0, 1, 2]


def test_a_malicious_checkpoint_is_refused_by_name_and_not_run(tmp_path):
    torch.save({"net": {"a": Bomb(tmp_path / "run")}}, tmp_path / "net.pth")
    with pytest.raises(CheckpointError, match=r"net\.pth is refused: it would run (posix|nt)\.mkdir"):
        read_tensors(tmp_path / "net.pth", "net")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("share", [0.0, 0.5, 0.98])
def test_a_checkpoint_that_was_cut_off_is_named(tmp_path, share):
    torch.save({"net": {"a": torch.randn(1000)}}, tmp_path / "net.pth")
    data = (tmp_path / "net.pth").read_bytes()
    (tmp_path / "net.pth").write_bytes(data[: int(share * len(data))])
    with pytest.raises(CheckpointError, match=r"net\.pth is damaged, cut off"):
        read_tensors(tmp_path / "net.pth", "net")


def test_other_contents_are_named(tmp_path):
    torch.save({"model": {}, "step": 1}, tmp_path / "net.pth")
    with pytest.raises(CheckpointError, match=r"no entry 'net' \(found: model, step\)"):
        read_tensors(tmp_path / "net.pth", "net")
    torch.save({"net": {"a": 3}}, tmp_path / "net.pth")
    with pytest.raises(CheckpointError, match="no table of tensors"):
        read_tensors(tmp_path / "net.pth", "net")
    with pytest.raises(CheckpointError, match="is missing"):
        read_tensors(tmp_path / "none.pth", "net")


def test_a_pickled_table_of_arrays_is_read_without_numpys_own_reader(tmp_path, monkeypatch):
    mean, std = np.arange(52, dtype=np.float32), np.ones((52,), np.float64)
    np.save(tmp_path / "t.npy", np.array({"mean": mean, "std": std}, dtype=object), allow_pickle=True)
    monkeypatch.setattr(np, "load", None)
    table = read_table(tmp_path / "t.npy", ("mean", "std"), (52,))
    assert np.array_equal(table["mean"], mean)
    assert table["std"].dtype == np.float64


@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4, 5])
def test_every_protocol_that_arrays_are_pickled_with(protocol):
    array = np.random.default_rng(0).standard_normal((1000, 1)).astype(np.float32)
    assert np.array_equal(read_pickled_array(pickle.dumps(array, protocol=protocol)), array)
    fortran = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    assert np.array_equal(read_pickled_array(pickle.dumps(fortran, protocol=protocol)), fortran)


def test_a_malicious_table_is_refused_by_name_and_not_run(tmp_path):
    bomb = np.array({"mean": Bomb(tmp_path / "run"), "std": 1}, dtype=object)
    np.save(tmp_path / "t.npy", bomb, allow_pickle=True)
    with pytest.raises(CheckpointError, match=r"t\.npy is refused: it would run (posix|nt)\.mkdir"):
        read_table(tmp_path / "t.npy", ("mean", "std"), (52,))
    with pytest.raises(CheckpointError, match="no pickled array"):
        read_pickled_array(pickle.dumps(Bomb(tmp_path / "run")))
    for name in (b"cposix\nsystem\n(S'true'\ntR.", b"cbuiltins\neval\n(S'1'\ntR.", b"cnumpy\nload\n(S'x'\ntR."):
        with pytest.raises(CheckpointError, match="would run"):
            read_pickled_array(name)
    assert not (tmp_path / "run").exists()


def test_arrays_that_lie_about_their_size_are_refused():
    honest = pickle.dumps(np.zeros(4, np.float32), protocol=2)
    with pytest.raises(CheckpointError):
        read_pickled_array(honest.replace(b"K\x04\x85", b"K\x08\x85"))
    with pytest.raises(CheckpointError, match="array of"):
        read_pickled_array(pickle.dumps(np.zeros(4, np.complex64), protocol=2))


def test_tables_arrays_and_matrices_say_what_is_wrong(tmp_path):
    np.save(tmp_path / "t.npy", np.array({"mean": np.zeros(52)}, dtype=object), allow_pickle=True)
    with pytest.raises(CheckpointError, match="no array 'std'"):
        read_table(tmp_path / "t.npy", ("mean", "std"), (52,))
    (tmp_path / "t.npy").write_bytes((tmp_path / "t.npy").read_bytes()[:200])
    with pytest.raises(CheckpointError, match="damaged, cut off"):
        read_table(tmp_path / "t.npy", ("mean",), (52,))
    np.save(tmp_path / "a.npy", np.full((2, 3), np.nan))
    with pytest.raises(CheckpointError, match="not finite"):
        read_array(tmp_path / "a.npy", (2, 3))
    with pytest.raises(CheckpointError, match="wanted numbers of shape"):
        read_array(tmp_path / "a.npy", (2, 531))
    np.savez(tmp_path / "a.npz", names=np.array(["x"]))
    with pytest.raises(CheckpointError, match="offsets"):
        read_arrays(tmp_path / "a.npz", ("names", "offsets"))
    (tmp_path / "m.json").write_text('{"a": [[1,0,0,5],[0,1,0,5],[0,0,1,5],[0,0,0,1]], "b": [[1,0,0],[0,1,0],[0,0,1]]}')
    assert np.array_equal(read_matrices(tmp_path / "m.json", ("b", "a")), np.stack([np.eye(3)] * 2))
    with pytest.raises(CheckpointError, match="no matrix for c"):
        read_matrices(tmp_path / "m.json", ("a", "c"))


def zipped(path: Path, entries: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return path


def test_a_checkpoint_that_unpacks_to_more_than_it_has_is_refused(tmp_path):
    torch.save({"net": {"a": torch.zeros(5_000_000)}}, tmp_path / "plain.pth")
    with zipfile.ZipFile(tmp_path / "plain.pth") as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    with pytest.raises(CheckpointError, match=r"packed\.pth unpacks to"):
        read_tensors(zipped(tmp_path / "packed.pth", entries), "net")


@pytest.mark.parametrize(
    "body", [b"cbuiltins\nbytearray\nJ\x00\x00\x00\x40\x85R.", b"ctorch\nTensor\nJ\x00\x00\x00\x40\x85R."]
)
def test_a_checkpoint_that_asks_for_memory_is_refused(tmp_path, body):
    """torch's reader for weights calls both: 1 GB from 30 bytes."""
    entries = {"net/data.pkl": b"\x80\x02" + body, "net/version": b"3\n", "net/byteorder": b"little"}
    with zipfile.ZipFile(tmp_path / "net.pth", "w") as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    with pytest.raises(CheckpointError, match=r"net\.pth is refused: it would run (builtins\.bytearray|torch\.Tensor)"):
        read_tensors(tmp_path / "net.pth", "net")


def test_a_tensor_larger_than_its_numbers_is_refused(tmp_path):
    torch.save({"net": {"a": torch.zeros(1).expand(1 << 40)}}, tmp_path / "net.pth")
    with pytest.raises(CheckpointError, match="larger than its numbers"):
        read_tensors(tmp_path / "net.pth", "net")


def test_arrays_that_unpack_to_too_much_or_lie_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(foreign_files, "PICKLED_BYTES", 1 << 20)
    np.savez_compressed(tmp_path / "a.npz", names=np.zeros(1 << 18))
    with pytest.raises(EchoAvatarError, match="unpacks to"):
        read_arrays(tmp_path / "a.npz", ("names",))
    header = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
    lying = header.ljust(127) + b"\n"
    with pytest.raises(CheckpointError, match="there is less"):
        read_arrays(zipped(tmp_path / "b.npz", {"names.npy": lying}), ("names",))
    (tmp_path / "b.npy").write_bytes(lying)
    with pytest.raises(CheckpointError, match="there is less"):
        read_array(tmp_path / "b.npy", (-1,))


def test_a_pipe_is_refused_before_it_is_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for read, wanted in ((read_array, (2,)), (read_matrices, ("a",)), (read_arrays, ("a",)), (read_tensors, "net")):
        with pytest.raises(EchoAvatarError, match="not a regular file"):
            read(tmp_path / "pipe", wanted)


def test_nested_json_is_refused(tmp_path):
    (tmp_path / "m.json").write_text("[" * 100_000)
    with pytest.raises(CheckpointError, match="is damaged"):
        read_matrices(tmp_path / "m.json", ("a",))


def test_a_pickle_beyond_the_limit_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "a.npy").open("wb") as file:
        file.truncate(PICKLED_BYTES + 1)
    with pytest.raises(CheckpointError, match="at most 67,108,864 are read"):
        read_table(tmp_path / "a.npy", ("mean",), (3,))
