import numpy as np
import pytest

from echoavatar.files.avatar.gltf_buffer import Buffer, Tracks


def test_views_are_aligned_and_hold_the_bytes() -> None:
    buffer = Buffer()
    buffer.add(np.arange(3, dtype=np.uint8))
    index = buffer.add(np.ones((2, 3), np.float32), bounds=True)
    view = buffer.views[buffer.accessors[index]["bufferView"]]
    assert view["byteOffset"] == 4
    assert bytes(buffer.data[4:28]) == np.ones(6, np.float32).tobytes()
    assert buffer.accessors[index]["max"] == [1, 1, 1]


@pytest.mark.parametrize("count", [2, 5])
def test_sparse_bounds_count_the_zeros_only_if_there_are_any(count: int) -> None:
    buffer = Buffer()
    places = buffer.view(np.array([0, 1], np.uint16))
    values = np.array([[1, 2, 3], [4, 5, 6]], np.float32)
    accessor = buffer.accessors[buffer.sparse(count, places, values, bounds=True)]
    assert accessor["min"] == ([1, 2, 3] if count == 2 else [0, 0, 0])
    assert accessor["sparse"]["count"] == 2


def test_nothing_that_moves_is_all_zeros() -> None:
    buffer = Buffer()
    accessor = buffer.accessors[buffer.sparse(4, -1, np.zeros((0, 3)), bounds=True)]
    assert "sparse" not in accessor
    assert accessor["max"] == [0, 0, 0]


def test_tracks_share_a_clock_and_integers_are_normalised() -> None:
    tracks = Tracks(Buffer(), 4, 30)
    tracks.add(3, "translation", np.zeros((4, 3)))
    tracks.add(5, "rotation", np.zeros((4, 4), np.int16))
    assert [channel["target"] for channel in tracks.channels] == [
        {"node": 3, "path": "translation"},
        {"node": 5, "path": "rotation"},
    ]
    clock, floats, integers = tracks.buffer.accessors
    assert {sampler["input"] for sampler in tracks.samplers} == {0}
    assert clock["max"] == [pytest.approx(0.1)]
    assert "normalized" not in floats
    assert integers["normalized"]
