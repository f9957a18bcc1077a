"""`echoavatar align` end to end on a bundle of random weights."""

import json

from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import save_clips

from echoavatar.cli import main


def test_pairs_then_dpo_and_grpo_from_the_command_line(tmp_path, tiny_bundle, capsys):
    tokens = save_clips(tmp_path / "tokens", 3, 8)
    reference_statistics().save(tmp_path / "y.json")
    common = [
        str(tokens),
        "--model",
        str(tiny_bundle),
        "--reference-statistics",
        str(tmp_path / "y.json"),
        "--reward",
        "liveliness=1",
    ]
    pairs = str(tmp_path / "pairs.jsonl")
    sizes = ["--past", "1", "--length", "1", "--fewest-events", "0", "--margin", "0", "--prompts", "3"]
    assert main(["align", "rollouts", *common, "-o", pairs, *sizes]) == 0
    assert "pairs in" in capsys.readouterr().out
    small = ["--recipe", "tiny", "--steps", "1"]
    assert main(["align", "dpo", *common, "-o", str(tmp_path / "dpo"), "--pairs", pairs, *small]) == 0
    assert main(["align", "grpo", *common, "-o", str(tmp_path / "grpo"), *small, "--kl-weight", "0.5"]) == 0
    card = json.loads((tmp_path / "grpo" / "card.json").read_text())
    assert card["alignment"]["kl_weight"] == 0.5
    assert card["command"].startswith("echoavatar align grpo")
    assert main(["align", "grpo", *common, "-o", str(tmp_path / "bad"), "--reward", "nonsense=1", *small]) == 1
    assert "no reward 'nonsense'" in capsys.readouterr().err
    assert main(["align", "grpo", *common, "-o", str(tmp_path / "bad"), "--reward", "quality=1", *small]) == 1
    assert "the reward quality is learned first: pass --quality" in capsys.readouterr().err
