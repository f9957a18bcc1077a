from pathlib import Path

from tests.cli.test_train_fingers import corpus

from echoavatar.checkpoint import read_card
from echoavatar.cli import main

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
