"""Sequences against a naive loop."""

import torch

from echoavatar.models.tokens import Depth, Interleaved, Prefix
from echoavatar_lab.models.generator.sequences import build_sequences, compact_layout, heard_at
from echoavatar_lab.models.tokens import audio_ids, motion_ids

LAYOUT = compact_layout(audio_codes=7, motion_layers=2, motion_codes=5)  # 6 segments, 12 motion ids a chunk
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
    sequences = build_sequences(Interleaved(LAYOUT, 15), audio, motion, motion, NONE)
    whole = [0]
    for chunk in range(3):
        whole += audio_ids(LAYOUT, audio[:, 20 * chunk : 20 * chunk + 20])[0].tolist()
        whole += motion_ids(LAYOUT, motion[:, 2 * chunk : 2 * chunk + 2])[0].tolist()
    assert sequences.ids[0].tolist() == whole[:-1]
    check_predictors(sequences, whole, motion)


def test_prefix_puts_all_audio_before_all_motion():
    audio, motion = codes(3)
    sequences = build_sequences(Prefix(LAYOUT, 3), audio, motion, motion, NONE)
    whole = [1, *audio_ids(LAYOUT, audio)[0].tolist(), 2, *motion_ids(LAYOUT, motion)[0].tolist()]
    assert sequences.ids[0].tolist() == whole[:-1]
    assert bool(sequences.valid.all())
    check_predictors(sequences, whole, motion)


def test_targets_are_clean_where_the_context_is_corrupted():
    audio, motion = codes(2)
    context = (motion + 1) % 5
    for order in (Interleaved(LAYOUT, 15), Prefix(LAYOUT, 2)):
        sequences = build_sequences(order, audio, context, motion, NONE)
        clean = build_sequences(order, audio, motion, motion, NONE)
        assert torch.equal(sequences.targets, clean.targets)
        assert not torch.equal(sequences.ids, clean.ids)


def test_missing_chunks_carry_no_loss_and_in_a_prefix_are_not_there():
    audio, motion = codes(3)
    sequences = build_sequences(Prefix(LAYOUT, 3), audio, motion, motion, NONE + 1)
    assert sequences.mask.tolist() == [[False, False, True, True, True, True]]
    assert (~sequences.valid[0]).nonzero().flatten().tolist() == [*range(1, 41), *range(122, 134)]


def test_the_place_where_a_frame_has_been_heard_holds_its_last_code():
    audio, motion = codes(3)
    for order in (Interleaved(LAYOUT, 15), Prefix(LAYOUT, 3)):
        ids = build_sequences(order, audio, motion, motion, NONE).ids[0]
        assert torch.equal(ids[heard_at(order, 3)], audio_ids(LAYOUT, audio)[0].view(-1, 2)[:, 1])


def test_the_depth_order_puts_each_frames_sound_before_its_motion_and_counts_hidden_states():
    layout = compact_layout(audio_codes=16, motion_layers=2, motion_codes=8)
    order = Depth(layout, 3)
    audio = torch.arange(80).view(1, 40, 2) % 16
    motion = torch.arange(24).view(1, 4, 3, 2) % 8
    made = build_sequences(order, audio, motion, motion, torch.tensor([1]))
    frames = made.ids.view(4, 26)
    assert torch.equal(frames[:, :20].reshape(1, -1), audio_ids(layout, audio))
    assert torch.equal(frames[:, 20:].reshape(1, -1), motion_ids(layout, motion))
    assert made.predictors[:, 1].tolist() == [6, 7, 8, 9, 10, 11]
    assert made.targets[0, :, 1].tolist() == motion[0, 1].flatten().tolist()
    assert made.mask.tolist() == [[False, False, True, True]]
    assert order.lookback == 6
