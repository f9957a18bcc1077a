"""Judging in pieces gives the rewards of judging at once."""

import numpy as np
import torch
from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import clips

from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar_lab.align import judge as room
from echoavatar_lab.align.judge import DecodingJudge
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.align.rewards import RewardMix


def test_pieces_change_nothing(tiny_bundle, monkeypatch):
    judge = DecodingJudge(
        BodyTokenizer.load(tiny_bundle / "tokenizer"),
        RewardMix({"beats": 1.0, "smoothness": 1.0}, reference_statistics()),
    )
    prompts = PromptSampler(clips(), past=1, length=3).spread(3)
    codes = torch.randint(8, (6, 6, 3, 2), generator=torch.Generator().manual_seed(0))
    whole = judge(prompts, codes)
    monkeypatch.setattr(room, "PIECE", 2)
    pieces = judge(prompts, codes)
    np.testing.assert_allclose(pieces.total, whole.total, atol=1e-6)
    assert whole.parts.keys() == {"beats", "smoothness"}
    assert whole.tokens.shape == (6, 6)
