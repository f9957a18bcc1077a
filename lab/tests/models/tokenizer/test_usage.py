import pytest
import torch

from echoavatar_lab.models.tokenizer.usage import code_usage


def test_usage_counts_codes_that_occur_and_ignores_skipped_layers():
    """Layer 0 uses 2 of 4 codes equally (perplexity 2); layer 1 uses one, and -1 does not count."""
    codes = torch.tensor([[[0, 3], [1, -1], [0, 3], [1, -1]]])
    usage = code_usage(codes, 4)
    assert usage.fraction.tolist() == [0.5, 0.25]
    assert usage.perplexity.tolist() == pytest.approx([2.0, 1.0])
