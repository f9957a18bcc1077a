import json
from pathlib import Path

import pytest
import torch

from echoavatar.cli import main
from echoavatar.corpora.rehearsal.corpus import Plan, make_clip
from echoavatar.evaluation.true_codes import true_codes
from echoavatar.models.tokenizer import BodyTokenizer


class Perfect(BodyTokenizer):
    """Hands features through as they are."""

    def encode(self, features):
        self.kept = features
        return torch.zeros(1, len(features[0]) // 4, 3, 4, dtype=torch.int64)

    def decode(self, codes):
        return self.kept


def test_a_perfect_tokenizer_keeps_all_of_the_timing(tiny_bundle: Path):
    clips = [make_clip(Plan(1.0, 47, Path("unused"), clip_seconds=32.0), index) for index in (0, 3, 5)]
    tokenizer = BodyTokenizer.load(tiny_bundle / "tokenizer")
    random = true_codes(tokenizer, clips)
    tokenizer.__class__ = Perfect
    found = true_codes(tokenizer, clips)
    assert found["decoded"] == pytest.approx(found["truth"], abs=0.02)
    assert found["truth"]["onset_excess"] > 0.08
    assert random["decoded"]["onset_excess"] < 0.5 * random["truth"]["onset_excess"]
    assert random["tokenizer"]["mpjpe_body_mm"] > 10 * found["tokenizer"]["mpjpe_body_mm"]


def test_the_command_ends_with_json(tiny_bundle: Path, capsys: pytest.CaptureFixture[str]):
    folder = str(tiny_bundle)
    assert main(["evaluate", folder, "--codes", "--clips", "2", "--tokenizer", f"{folder}/tokenizer"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1]).keys() == {"tokenizer", "truth", "decoded", "shown"}
