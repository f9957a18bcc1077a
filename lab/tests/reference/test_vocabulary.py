"""The rows that can occur, and that the same prompt comes of them."""

import torch

from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokens import REFERENCE_LAYOUT
from echoavatar_lab.reference.vocabulary import compacted, occurring


def test_of_166690_rows_11270_are_kept():
    rows, layout = occurring(), compacted()
    assert len(rows) == layout.vocabulary == 6 + 2048 + 9216
    assert len(set(rows.tolist())) == len(rows)
    assert rows.max() < REFERENCE_LAYOUT.vocabulary


def test_a_prompt_over_the_kept_rows_is_the_published_prompt():
    random = torch.Generator().manual_seed(0)
    audio = torch.randint(1024, (1, 300, 2), generator=random)
    motion = torch.randint(512, (1, 27, 3, 6), generator=random)
    missing, prompts = torch.zeros(1, dtype=torch.int64), []
    for layout in (compacted(), REFERENCE_LAYOUT):
        config = GeneratorConfig(layout=layout, sequence="prefix")
        shown = torch.tensor([[layout.segment_start(6) + 93, layout.segment_start(0) + 495]])
        prompts.append(config.order.prompt(audio, motion, missing, shown)[0])
    assert torch.equal(occurring()[prompts[0]], prompts[1])
