from pathlib import Path

import torch
from lab.tests.commands.test_train_fingers import corpus
from transformers import EncodecConfig, EncodecModel

from echoavatar.checkpoint import read_card
from echoavatar.cli import main
from echoavatar.models.audio import AudioCodec
from echoavatar_lab.models.published import read_encodec

RECIPE = """
model: {filters: 2, width: 8, codes: 16, lstm_layers: 1}
training: {minutes: 0, steps: 3, batch: 2, decoded: 1, crop_frames: 10, unquantized: 9, log_every: 1}
"""


def test_a_recipe_makes_it_small_and_the_card_says_what_was_given(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(RECIPE)
    source = corpus(tmp_path / "corpus")
    words = ["train", "codec", str(source), "-o", str(tmp_path / "run"), "--recipe", str(tmp_path / "r.yaml")]
    assert main(words) == 0
    card = read_card(tmp_path / "run")
    assert card["steps_done"] == 3
    assert card["command"] == f"echoavatar train codec {source} -o {tmp_path}/run --recipe {tmp_path}/r.yaml"


def test_a_published_encodec_is_taken_by_one_command(tmp_path: Path) -> None:
    torch.manual_seed(0)
    sizes = {"num_filters": 2, "hidden_size": 16, "codebook_size": 64, "target_bandwidths": [0.9]}
    EncodecModel(EncodecConfig(**sizes)).save_pretrained(tmp_path / "theirs")
    made, source = tmp_path / "codec", str(tmp_path)
    assert main(["train", "codec", source, "-o", str(made), "--from", str(tmp_path / "theirs")]) == 0
    taken = AudioCodec.load(made)
    sound = torch.randn(1, 6400)
    assert torch.equal(taken.encode(sound), read_encodec(tmp_path / "theirs").encode(sound))
