"""The reliance metric exchanges audio between clips and counts by domain."""

import numpy as np
import torch
from tests.models.generator.tiny import generator

from echoavatar_lab.models.generator.reliance import _windows, nll_by_domain
from echoavatar_lab.models.generator.windows import TokenClip


def clips():
    rng = np.random.default_rng(0)
    lengths = (7, 4, 6, 5)
    return [
        TokenClip(np.full((20 * n, 2), i), rng.integers(8, size=(2 * n, 3, 2)), np.full(2 * n, i % 3, np.uint8))
        for i, n in enumerate(lengths)
    ]


def test_every_window_hears_another_clip():
    windows, audio = _windows(clips(), 2, True)
    assert bool((windows.audio != audio).all())
    assert torch.equal(audio.flatten().sort().values, windows.audio.flatten().sort().values)


def test_domains_are_counted_apart_and_together():
    model = generator()
    apart = [nll_by_domain(model, [clip], chunks=2) for clip in clips()]
    means = nll_by_domain(model, clips(), chunks=2, batch=3)
    assert set(means) == {"silence", "speech", "music", "all"}
    torch.testing.assert_close(means["speech"], apart[1]["all"], atol=1e-5, rtol=1e-5)
    expected = sum(each["all"] * n for each, n in zip(apart, (3, 2, 3, 2), strict=True)) / 10
    torch.testing.assert_close(means["all"], expected, atol=1e-5, rtol=1e-5)


def test_corruption_of_the_context_changes_the_score_but_repeats():
    model = generator()
    clean, one, two = (nll_by_domain(model, clips(), chunks=2, corruption=rate)["all"] for rate in (0.0, 0.8, 0.8))
    assert one == two != clean
