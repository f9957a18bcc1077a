"""Positions of many continuations at once are those that the rewards judge."""

from pathlib import Path

import numpy as np
import torch
from lab.tests.align.tuning_fakes import clips

from echoavatar.engine.pipeline import load_bundle
from echoavatar_lab.align.decoded_motion import decode_continuations
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.align.tuning.positions import shown_positions


def test_positions_are_those_of_the_smoothed_motion(tiny_bundle: Path) -> None:
    tokenizer = load_bundle(tiny_bundle).tokenizer
    prompts = PromptSampler(clips(2, 16), past=6, length=8).draw(0, 3)
    codes = torch.from_numpy(np.stack([prompt.truth for prompt in prompts]).astype(np.int64))
    past = torch.from_numpy(np.stack([prompt.past for prompt in prompts]).astype(np.int64))
    found = shown_positions(tokenizer, past, codes).numpy()
    for row, motion in enumerate(decode_continuations(tokenizer, prompts, codes)):
        np.testing.assert_allclose(found[row], motion.positions, atol=1e-4)
