"""Pickles made to harm: each is refused at once, and the process stays as it was."""

import copyreg
import pickle  # noqa: TID251  # to make what must be refused  # noqa: TID251  # to make what must be refused
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from lab.tests.datasets.samples import pickled_frame

from echoavatar.errors import CheckpointError
from echoavatar_lab.foreign.foreign_files import read_pickled_array, read_pickled_frame
from echoavatar_lab.foreign.pickled_arrays import NOTED, RefusedError, frame_columns, unpickle_arrays

FLOATS = b"cnumpy\ndtype\n(X\x02\x00\x00\x00f4K\x00K\x01tR"
BIG_ENDIAN = b"(K\x03X\x01\x00\x00\x00>NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
NEW = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\nK\x00\x85C\x01btR"


def state(raw: bytes, count: int, kind: bytes = FLOATS) -> bytes:
    shape = b"J" + count.to_bytes(4, "little") + b"\x85"
    return b"(K\x01" + shape + kind + b"\x89" + raw + b"tb"


BOMBS = {
    "bytes of a number": NEW + state(b"J\x00\x5e\xd0\xb2", 750_000_000),
    "bytes of a small number": NEW + state(b"J\x00\x00\x00\x40", 1 << 28),
    "a memo as large as it asks": b"\x80\x04]r\xff\xff\xff\x7f" + b"J\x00\x00\x00\x40" + b"\x85" * 40 + b"0" + NEW,
    "one text encoded again and again": b"c_codecs\nencode\nq\x000X"
    + (1 << 20).to_bytes(4, "little")
    + b"a" * (1 << 20)
    + b"q\x010]"
    + b"h\x00h\x01X\x06\x00\x00\x00latin1\x86Ra" * 64,
    "one array again and again": b"B" + (1 << 20).to_bytes(4, "little") + bytes(1 << 20) + b"q\x010]"
    + (NEW + state(b"h\x01", 1 << 18) + b"a") * 64,
    "shared tuples as a key": b"}K\x01" + b"2\x86" * 60 + b"K\x01s",
    "shared tuples as a shape": NEW + b"(K\x01K\x01" + b"2\x86" * 60 + FLOATS + b"\x89C\x00tb",
    "a long name": b"c" + b"a" * 100_000 + b"\nb\n",
    "many empty lists": b"](" + b"]" * 200_000 + b"e",
    "the state of a function": b"cnumpy.core.numeric\n_frombuffer\n}X\x0c\x00\x00\x00__defaults__K\x01\x85sb",
    "slots of a function": b"cnumpy.core.numeric\n_frombuffer\nN}X\x0c\x00\x00\x00__defaults__K\x01\x85s\x86b",
    "NEWOBJ_EX": b"\x80\x04cnumpy\ndtype\n)}\x92",
    "NEWOBJ": b"\x80\x04cnumpy\nndarray\n)\x81",
    "another byte order": NEW + state(b"C\x04abcd", 1, FLOATS + BIG_ENDIAN),
    "an array behind too many steps": b"N0" * 60_000 + NEW + state(b"C\x04abcd", 1),
    "no stack": b"\x86\x86R",
    "no end": b"]",
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused_in_little_memory(name: str) -> None:
    data = BOMBS[name] + (b"" if name == "no end" else b".")
    tracemalloc.start()
    try:
        with pytest.raises(CheckpointError, match="no pickled array") as caught:
            read_pickled_array(data)
        assert tracemalloc.get_traced_memory()[1] < 8 * len(data) + (16 << 20)
    finally:
        tracemalloc.stop()
    assert len(str(caught.value)) < 300


CALLS = (
    "os system", "posix mkdir", "subprocess Popen", "builtins eval", "builtins exec", "builtins compile",
    "builtins __import__", "builtins getattr", "builtins open", "shutil rmtree", "socket create_connection",
    "importlib import_module", "pickle loads", "numpy load", "numpy memmap", "torch load", "ctypes CDLL",
    "operator attrgetter", "functools partial", "numpy.core.multiarray fromstring",
)  # fmt: skip
WAYS: dict[str, Callable[[str, str], bytes]] = {
    "called": lambda module, name: f"c{module}\n{name}\n(Vnever-made\ntR.".encode(),
    "called by a name from the stack": lambda module, name: (
        b"\x80\x04" + text(module) + text(name) + b"\x93" + text("never-made") + b"\x85R."
    ),
    "INST": lambda module, name: f"(Vnever-made\ni{module}\n{name}\n.".encode(),
    "OBJ": lambda module, name: f"(c{module}\n{name}\nVnever-made\no.".encode(),
    "NEWOBJ": lambda module, name: f"c{module}\n{name}\n(Vnever-made\nt\x81.".encode("latin-1"),
    "NEWOBJ_EX": lambda module, name: f"\x80\x04c{module}\n{name}\n(Vnever-made\nt}}\x92.".encode("latin-1"),
    "inside an array": lambda module, name: NEW + f"(K\x01c{module}\n{name}\n(Vnever-made\ntRtb.".encode(),
}


def text(word: str) -> bytes:
    return b"\x8c" + bytes([len(word)]) + word.encode()


@pytest.mark.parametrize("way", WAYS)
def test_no_code_is_run_whichever_way_it_is_named(way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """20 functions, each in 7 ways. The last lines show that Python itself would have run them."""
    monkeypatch.chdir(tmp_path)
    for call in CALLS:
        with pytest.raises(RefusedError, match="would run|makes an object"):
            unpickle_arrays(WAYS[way](*call.split()))
    assert not list(tmp_path.iterdir())
    if not way.startswith("NEWOBJ"):  # these two make objects of classes alone
        with suppress(Exception):
            pickle.loads(WAYS[way]("posix", "mkdir"))
        assert [made.name for made in tmp_path.iterdir()] == ["never-made"]


def test_names_outside_the_list_and_objects_are_told_apart() -> None:
    with pytest.raises(RefusedError, match=r"would run os\.system"):
        unpickle_arrays(b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(RefusedError, match="makes an object"):
        unpickle_arrays(b"cnumpy\nndarray\n)\x81.")
    with pytest.raises(RefusedError, match="would run"):
        unpickle_arrays(pickle.dumps(copyreg.__newobj__, protocol=4))


def test_a_table_shares_what_python_shares() -> None:
    array = np.arange(5, dtype=np.float64)
    stored = unpickle_arrays(pickle.dumps({"a": [array, array], "b": None, "c": (1.5, True)}))
    assert stored["a"][0] is stored["a"][1]
    np.testing.assert_array_equal(stored["a"][0].content, array)
    assert stored["b"] is None
    assert stored["c"] == (1.5, True)


FIXTURES = Path(__file__).parents[3] / "tests/fixtures/pandas"
KNOWN = {f"J{joint}_{axis}": np.arange(4.0) * 6 + 3 * joint + n for joint in (0, 1) for n, axis in enumerate(
    ("alpha", "beta", "gamma")
)}  # fmt: skip


def assert_known(found: dict[str, np.ndarray]) -> None:
    assert list(found) == list(KNOWN)
    for name, column in KNOWN.items():
        np.testing.assert_array_equal(found[name], column)


@pytest.mark.parametrize("name", ["pandas_1.5.pkl", "pandas_3.1.pkl"])
def test_what_pandas_wrote_is_read_without_it(name: str) -> None:
    """Written from `DataFrame(arange(24).reshape(4, 6))` with those names and an index of time."""
    assert_known(read_pickled_frame(FIXTURES / name))


@pytest.mark.parametrize("is_old", [False, True])
def test_both_forms(is_old: bool) -> None:
    assert_known(frame_columns(unpickle_arrays(pickled_frame(KNOWN, is_old=is_old), NOTED)))


def test_what_is_no_frame_of_numbers_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps({"a": np.zeros(3)}))
    with pytest.raises(CheckpointError, match=r"a\.pkl is refused: it holds no data frame"):
        read_pickled_frame(path)
    path.write_bytes(pickled_frame(KNOWN)[:-1] + b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(CheckpointError, match=r"a\.pkl is refused: it would run os\.system"):
        read_pickled_frame(path)
    path.write_bytes(pickled_frame(KNOWN)[:-20])
    with pytest.raises(CheckpointError, match=r"a\.pkl is refused: it has no end|a\.pkl is damaged"):
        read_pickled_frame(path)


def test_blocks_that_do_not_fit_are_refused() -> None:
    whole = pickled_frame(KNOWN)
    fewer = whole.replace(b"K\x00K\x06K\x01", b"K\x00K\x05K\x01")
    assert fewer != whole
    with pytest.raises(RefusedError, match="not known"):
        frame_columns(unpickle_arrays(fewer, NOTED))


def test_nothing_is_noted_that_was_not_asked_for() -> None:
    with pytest.raises(RefusedError, match=r"would run pandas\.core\.frame\.DataFrame"):
        unpickle_arrays(pickled_frame(KNOWN))
