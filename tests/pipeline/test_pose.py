import numpy as np
import torch

from echoavatar.pipeline.pose import keep, new_rows, with_past


def test_memory_is_written_in_active_rows_only() -> None:
    memory = torch.zeros(3, 2)
    keep(memory, np.ones((3, 2), np.float32), np.array([True, False, True]))
    assert memory.tolist() == [[1, 1], [0, 0], [1, 1]]


def test_a_new_row_has_its_first_frame_as_past() -> None:
    """Two points, three frames, two rows; the second row has no past."""
    now = np.arange(12, dtype=np.float32).reshape(2, 3, 2)
    past = np.full((2, 2), -1, np.float32)
    joined = with_past(now, past, new_rows(np.array([1.0, 0.0])))
    assert joined.shape == (2, 4, 2)
    assert joined[:, 0].tolist() == [[-1, 1], [-1, 7]]
    assert np.array_equal(joined[:, 1:], now)
    assert new_rows(np.ones(2)) is None
