import time

import numpy as np

from echoavatar.bench.cache_pressure import evict_caches


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
