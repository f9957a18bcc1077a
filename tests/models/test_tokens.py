"""Rows of the vocabulary, and the sizes of an order."""

import pytest
from pydantic import ValidationError

from echoavatar.models.tokens import Interleaved, TokenLayout
from echoavatar_lab.models.generator.sequences import compact_layout


def test_overlapping_rows_are_refused():
    with pytest.raises(ValidationError, match="motion_base"):
        TokenLayout(audio_codes=1024)
    with pytest.raises(ValidationError, match="vocabulary"):
        TokenLayout(motion_layers=6)
    with pytest.raises(ValidationError, match="special"):
        TokenLayout(before_audio=(4,))


def test_a_body_of_one_part_has_a_third_of_the_segments():
    layout = compact_layout(audio_codes=4, motion_layers=3, motion_codes=5, parts=1)
    assert (layout.segments, layout.vocabulary) == (3, 4 + 2 * 4 + 3 * 5)


def test_a_four_second_window_of_the_paper_has_600_audio_and_540_motion_ids():
    order = Interleaved(TokenLayout(motion_layers=6, vocabulary=20_000), 15)
    assert (15 * order.audio_per_chunk, 15 * order.motion_per_chunk) == (600, 540)
    assert order.lookback == 1140
