"""Sequences against a naive loop."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from echoavatar.models.tokens import PARTS, REFERENCE_LAYOUT, Interleaved, Prefix, TokenLayout, sequence_order


@given(st.integers(1, 4), st.integers(2, 30), st.integers(2, 30), st.integers(0, 1000))
def test_motion_codes_come_back_from_their_ids_in_any_layout(depth, motion_codes, audio_codes, seed):
    layout = TokenLayout.compact(audio_codes=audio_codes, motion_layers=depth, motion_codes=motion_codes)
    random = torch.Generator().manual_seed(seed)
    motion = torch.randint(motion_codes, (2, 3, PARTS, depth), generator=random)
    starts = torch.tensor([layout.segment_start(segment) for segment in range(layout.segments)]).repeat(3)
    assert torch.equal(layout.unflatten(layout.motion_ids(motion) - starts), motion)
    assert torch.equal(layout.unflatten(layout.flatten(motion)), motion)


def test_every_code_has_a_row_of_its_own_and_the_table_is_full():
    """4 specials + 2 x 3 audio + 3 x 2 x 5 motion = 40 rows."""
    layout = TokenLayout.compact(audio_codes=3, motion_layers=2, motion_codes=5)
    motion = torch.arange(5)[None, :, None, None].expand(1, 5, PARTS, 2)
    audio = torch.arange(3)[None, :, None].expand(1, 3, 2)
    ids = torch.cat([layout.motion_ids(motion)[0], layout.audio_ids(audio)[0]])
    assert layout.vocabulary == 40
    assert sorted(ids.tolist()) == list(range(4, 40))


def test_motion_is_ordered_by_time_then_part_then_layer():
    layout = TokenLayout.compact(audio_codes=3, motion_layers=2, motion_codes=5)
    motion = torch.zeros(1, 2, PARTS, 2, dtype=torch.int64)
    motion[0, 1, 2, 0] = 4  # second time step, hands, first layer: segment 4 of 6
    ids = layout.motion_ids(motion)[0]
    assert ids[6 + 4] == layout.segment_start(4) + 4
    assert [int(i) for i in ids[:6]] == [layout.segment_start(k) for k in range(6)]


def test_the_reference_layout_has_the_rows_of_the_release():
    layout = REFERENCE_LAYOUT
    hands_first_layer = torch.zeros(1, 1, PARTS, 6, dtype=torch.int64)
    hands_first_layer[0, 0, 2, 0] = 7
    assert layout.vocabulary == 166_690
    assert layout.segments == 18
    assert layout.motion_ids(hands_first_layer)[0, 12] == 156_690 + 512 * 12 + 7
    assert layout.audio_ids(torch.tensor([[[5, 9]]])).tolist() == [[151_690 + 5, 151_690 + 1024 + 9]]


def test_overlapping_rows_are_refused():
    with pytest.raises(ValidationError, match="motion_base"):
        TokenLayout(audio_codes=1024)
    with pytest.raises(ValidationError, match="vocabulary"):
        TokenLayout(motion_layers=6)
    with pytest.raises(ValidationError, match="special"):
        TokenLayout(before_audio=(4,))


def test_a_body_of_one_part_has_a_third_of_the_segments():
    layout = TokenLayout.compact(audio_codes=4, motion_layers=3, motion_codes=5, parts=1)
    assert (layout.segments, layout.vocabulary) == (3, 4 + 2 * 4 + 3 * 5)
    assert layout.unflatten(torch.zeros(2, 12, dtype=torch.int64)).shape == (2, 4, 1, 3)


LAYOUT = TokenLayout.compact(audio_codes=7, motion_layers=2, motion_codes=5)  # 6 segments, 12 motion ids a chunk
NONE = torch.zeros(1, dtype=torch.int64)


def codes(chunks):
    random = torch.Generator().manual_seed(chunks)
    audio = torch.randint(7, (1, 20 * chunks, 2), generator=random)
    return audio, torch.randint(5, (1, 2 * chunks, 3, 2), generator=random)


def check_predictors(sequences, whole, motion):
    """The id after each predictor is the id of the code it must predict."""
    for segment in range(6):
        for step in range(motion.shape[1]):
            at = int(sequences.predictors[segment, step])
            code = int(motion.flatten(2)[0, step, segment])
            assert int(sequences.targets[0, segment, step]) == code
            assert int(whole[at + 1]) == LAYOUT.segment_start(segment) + code


def test_interleaved_puts_each_chunk_of_audio_before_its_motion():
    audio, motion = codes(3)
    sequences = Interleaved(LAYOUT, 15).build(audio, motion, motion, NONE)
    whole = [0]
    for chunk in range(3):
        whole += LAYOUT.audio_ids(audio[:, 20 * chunk : 20 * chunk + 20])[0].tolist()
        whole += LAYOUT.motion_ids(motion[:, 2 * chunk : 2 * chunk + 2])[0].tolist()
    assert sequences.ids[0].tolist() == whole[:-1]
    check_predictors(sequences, whole, motion)


def test_prefix_puts_all_audio_before_all_motion():
    audio, motion = codes(3)
    sequences = Prefix(LAYOUT, 3).build(audio, motion, motion, NONE)
    whole = [1, *LAYOUT.audio_ids(audio)[0].tolist(), 2, *LAYOUT.motion_ids(motion)[0].tolist()]
    assert sequences.ids[0].tolist() == whole[:-1]
    assert bool(sequences.valid.all())
    check_predictors(sequences, whole, motion)


def test_targets_are_clean_where_the_context_is_corrupted():
    audio, motion = codes(2)
    context = (motion + 1) % 5
    for order in (Interleaved(LAYOUT, 15), Prefix(LAYOUT, 2)):
        sequences = order.build(audio, context, motion, NONE)
        clean = order.build(audio, motion, motion, NONE)
        assert torch.equal(sequences.targets, clean.targets)
        assert not torch.equal(sequences.ids, clean.ids)


def test_missing_chunks_carry_no_loss_and_in_a_prefix_are_not_there():
    audio, motion = codes(3)
    sequences = Prefix(LAYOUT, 3).build(audio, motion, motion, NONE + 1)
    assert sequences.mask.tolist() == [[False, False, True, True, True, True]]
    assert (~sequences.valid[0]).nonzero().flatten().tolist() == [*range(1, 41), *range(122, 134)]


def test_a_four_second_window_of_the_paper_has_600_audio_and_540_motion_ids():
    order = sequence_order("interleaved", TokenLayout(motion_layers=6, vocabulary=20_000), 15)
    assert (15 * order.audio_per_chunk, 15 * order.motion_per_chunk) == (600, 540)
    assert order.lookback == 1140


def test_the_place_where_a_frame_has_been_heard_holds_its_last_code():
    audio, motion = codes(3)
    for order in (Interleaved(LAYOUT, 15), Prefix(LAYOUT, 3)):
        ids = order.build(audio, motion, motion, NONE).ids[0]
        assert torch.equal(ids[order.heard(3)], LAYOUT.audio_ids(audio)[0].view(-1, 2)[:, 1])


def test_the_depth_order_puts_each_frames_sound_before_its_motion_and_counts_hidden_states():
    layout = TokenLayout.compact(audio_codes=16, motion_layers=2, motion_codes=8)
    order = sequence_order("depth", layout, 3)
    audio = torch.arange(80).view(1, 40, 2) % 16
    motion = torch.arange(24).view(1, 4, 3, 2) % 8
    made = order.build(audio, motion, motion, torch.tensor([1]))
    frames = made.ids.view(4, 26)
    assert torch.equal(frames[:, :20].reshape(1, -1), layout.audio_ids(audio))
    assert torch.equal(frames[:, 20:].reshape(1, -1), layout.motion_ids(motion))
    assert made.predictors[:, 1].tolist() == [6, 7, 8, 9, 10, 11]
    assert made.targets[0, :, 1].tolist() == motion[0, 1].flatten().tolist()
    assert made.mask.tolist() == [[False, False, True, True]]
    assert order.lookback == 6
    assert order.heard(1).tolist() == [0] * 10 + [1] * 10
