"""A config that cannot be is refused; the paper's is the paper's."""

import pytest
from pydantic import ValidationError

from echoavatar.models.generator import GeneratorConfig, qwen_half_billion
from echoavatar.models.tokens import Interleaved, Prefix
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.reference.weights import REFERENCE_LAYOUT


def test_heads_must_divide():
    with pytest.raises(ValidationError, match="width"):
        GeneratorConfig(width=100, heads=3)
    with pytest.raises(ValidationError, match="kv_heads"):
        GeneratorConfig(heads=4, kv_heads=3)


def test_half_a_chunk_belongs_to_the_orders_that_can_make_it():
    for order in ("depth", "prefix"):
        assert GeneratorConfig(sequence=order, step=1).audio_frames == 10
    for order, step in (("interleaved", 1), ("depth", 3)):
        with pytest.raises(ValidationError, match=f"a step of {step} motion tokens belongs to the prefix order"):
            GeneratorConfig(sequence=order, step=step)


def test_the_order_follows_the_name():
    assert isinstance(GeneratorConfig().order, Interleaved)
    assert isinstance(GeneratorConfig(sequence="prefix").order, Prefix)


def test_the_default_window_is_the_papers_four_seconds():
    """15 chunks of 6,400 samples at 24 kHz = 4 s; with Q = 4 a chunk has 40 + 24 ids."""
    assert GeneratorConfig().order.lookback == 15 * 64


def test_the_paper_size_is_qwen_half_billion():
    size = qwen_half_billion(REFERENCE_LAYOUT)
    assert (size.width, size.layers, size.heads, size.kv_heads, size.mlp) == (896, 24, 14, 2, 4864)
    assert (size.head_width, size.rope_theta, size.sequence) == (64, 1e6, "prefix")


def test_sound_may_be_heard_ahead_while_the_window_still_holds_what_is_due():
    assert GeneratorConfig(window_chunks=4, ahead_chunks=3).ahead_chunks == 3
    with pytest.raises(ValidationError, match="under window_chunks"):
        GeneratorConfig(window_chunks=4, ahead_chunks=4)


def test_a_config_survives_json():
    config = GeneratorConfig(layout=compact_layout(audio_codes=7, motion_layers=1, motion_codes=3))
    assert GeneratorConfig.model_validate_json(config.model_dump_json()) == config
