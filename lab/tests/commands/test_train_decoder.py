"""The command from a corpus on disk: a recipe's settings reach the run, and codes keep their meaning."""

import numpy as np
import torch
from tests.models.motion_tokens import dance, small_body

from echoavatar.checkpoint import read_card
from echoavatar.cli import main
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar_lab.data import Clip
from echoavatar_lab.data.corpus import clip_path, write_manifest

RECIPE = "training: {batch: 2, tokens: 8, unheard: 1, log_every: 1}\n"


def test_a_tokenizer_comes_out_whose_codes_are_the_old_ones(tmp_path, capsys):
    for seed in range(3):
        body = dance(seed, 64)
        sound, domain = np.zeros(64 * 800, np.float32), np.zeros(64, np.uint8)
        split = "test" if seed == 2 else "train"
        clip = Clip(f"clip{seed}", sound, body.rotations, body.root, domain, split=split)
        path = clip_path(tmp_path / "corpus", clip.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        clip.save(path)
    write_manifest(tmp_path / "corpus")
    start = small_body()
    start.save(tmp_path / "tokenizer", {}, dtype=torch.float32)
    (tmp_path / "recipe.yaml").write_text(RECIPE)
    given = ["train", "decoder", tmp_path / "corpus", "-o", tmp_path / "out", "--steps", 2]
    given += ["--tokenizer", tmp_path / "tokenizer", "--recipe", tmp_path / "recipe.yaml"]
    assert main([str(word) for word in given]) == 0
    after = BodyTokenizer.load(tmp_path / "out")
    assert torch.allclose(after.codebooks(), start.codebooks(), atol=1e-2)
    card = read_card(tmp_path / "out")
    assert card["training"]["tokens"] == 8
    assert card["step"] == 2
    assert card["licence"] == "Apache-2.0"
    assert "--tokenizer" in card["command"]
    assert card["scores"]["mpjpe_body_mm"] > 0
