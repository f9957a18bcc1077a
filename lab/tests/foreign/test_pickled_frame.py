"""Data frames that pandas 1.5.3 and 3.1.1 pickled, and those of a form older than both."""

import pickle  # noqa: TID251  # to make what must be refused
from pathlib import Path

import numpy as np
import pytest
from lab.tests.datasets.samples import pickled_frame

from echoavatar.errors import CheckpointError
from echoavatar_lab.foreign.foreign_files import read_pickled_frame
from echoavatar_lab.foreign.pickled_arrays import RefusedError, unpickle_arrays
from echoavatar_lab.foreign.pickled_frame import NOTED, frame_columns

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
    with pytest.raises(CheckpointError, match=r"a\.pkl is refused: it has no end|a\.pkl is no pickle"):
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
