"""Ids of codes."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from echoavatar.models.tokens import PARTS
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.tokens import audio_ids, motion_ids, unflatten
from echoavatar_lab.reference.weights import REFERENCE_LAYOUT


@given(st.integers(1, 4), st.integers(2, 30), st.integers(2, 30), st.integers(0, 1000))
def test_motion_codes_come_back_from_their_ids_in_any_layout(depth, motion_codes, audio_codes, seed):
    layout = compact_layout(audio_codes=audio_codes, motion_layers=depth, motion_codes=motion_codes)
    random = torch.Generator().manual_seed(seed)
    motion = torch.randint(motion_codes, (2, 3, PARTS, depth), generator=random)
    starts = torch.tensor([layout.segment_start(segment) for segment in range(layout.segments)]).repeat(3)
    assert torch.equal(unflatten(layout, motion_ids(layout, motion) - starts), motion)
    assert torch.equal(unflatten(layout, motion.flatten(1)), motion)


def test_every_code_has_a_row_of_its_own_and_the_table_is_full():
    """4 specials + 2 x 3 audio + 3 x 2 x 5 motion = 40 rows."""
    layout = compact_layout(audio_codes=3, motion_layers=2, motion_codes=5)
    motion = torch.arange(5)[None, :, None, None].expand(1, 5, PARTS, 2)
    audio = torch.arange(3)[None, :, None].expand(1, 3, 2)
    ids = torch.cat([motion_ids(layout, motion)[0], audio_ids(layout, audio)[0]])
    assert layout.vocabulary == 40
    assert sorted(ids.tolist()) == list(range(4, 40))


def test_motion_is_ordered_by_time_then_part_then_layer():
    layout = compact_layout(audio_codes=3, motion_layers=2, motion_codes=5)
    motion = torch.zeros(1, 2, PARTS, 2, dtype=torch.int64)
    motion[0, 1, 2, 0] = 4  # second time step, hands, first layer: segment 4 of 6
    ids = motion_ids(layout, motion)[0]
    assert ids[6 + 4] == layout.segment_start(4) + 4
    assert [int(i) for i in ids[:6]] == [layout.segment_start(k) for k in range(6)]


def test_the_reference_layout_has_the_rows_of_the_release():
    layout = REFERENCE_LAYOUT
    hands_first_layer = torch.zeros(1, 1, PARTS, 6, dtype=torch.int64)
    hands_first_layer[0, 0, 2, 0] = 7
    assert layout.vocabulary == 166_690
    assert layout.segments == 18
    assert motion_ids(layout, hands_first_layer)[0, 12] == 156_690 + 512 * 12 + 7
    assert audio_ids(layout, torch.tensor([[[5, 9]]])).tolist() == [[151_690 + 5, 151_690 + 1024 + 9]]


def test_a_body_of_one_part_has_codes_of_its_layers_alone():
    layout = compact_layout(audio_codes=4, motion_layers=3, motion_codes=5, parts=1)
    assert unflatten(layout, torch.zeros(2, 12, dtype=torch.int64)).shape == (2, 4, 1, 3)
