import time

import numpy as np
import pytest

from echoavatar.bench.face import bench_face, evict_caches
from echoavatar.models.face import FaceConfig, MelConfig
from echoavatar_lab.models.face.model import FaceModel

TINY = FaceConfig(
    encoder=MelConfig(bands=8, windows=1, width=8, blocks=1),
    width=16,
    heads=2,
    layers=1,
    condition=8,
    head_width=4,
    head_blocks=1,
)


def test_times_of_one_and_of_a_batch_fit_together():
    report = bench_face(FaceModel(TINY).stream(), chunks=10, sessions=4)
    assert report["face_ms_p99"] >= report["face_ms_p50"] > 0
    assert report["sessions"] == 4
    assert report["batch_over_one"] == pytest.approx(report["batch_ms_p50"] / report["face_ms_p50"], rel=0.01)


def test_evicted_memory_takes_longer_to_read():
    """Reading 0.5 MB takes longer after the other models than at once."""
    work, mine = evict_caches(), np.ones(2**17, np.float32)

    def seconds() -> float:
        began = time.perf_counter()
        mine.sum()
        return time.perf_counter() - began

    near, far = [], []
    for _ in range(15):
        mine.sum()
        near.append(seconds())
        work()
        far.append(seconds())
    assert np.median(far) > np.median(near)
