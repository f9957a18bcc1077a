"""The learned rewards from the command line."""

import json

import numpy as np
import pytest
from tests.align.tuning import clips

from echoavatar.cli import main


@pytest.mark.slow
def test_each_reward_is_trained_measured_and_written(tmp_path, tiny_bundle, capsys):
    tokens = tmp_path / "tokens"
    tokens.mkdir()
    for name, clip in clips(4, chunks=16).items():
        object.__setattr__(clip, "split", "test" if name == "clip3" else "train")
        clip.save(tokens / f"{name}.npz")
    common = [str(tokens), "--bundle", str(tiny_bundle)]
    scores, quality, alignment = (str(tmp_path / name) for name in ("scores.json", "quality", "alignment"))
    assert main(["align", "calibrate", *common, "-o", scores, "--windows", "2"]) == 0
    small = ["--steps", "2", "--width", "16"]
    assert (
        main(
            ["align", "reward-quality", *common, "-o", quality, "--scores", scores, "--windows", "2", *small]
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert np.isfinite(found["pearson_levels"])
    assert main(["align", "reward-alignment", *common, "-o", alignment, *small]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert table["audio to motion, all"]["gallery"] == 1
    for folder in (quality, alignment):
        card = json.loads((tmp_path / folder / "card.json").read_text())
        assert {"data", "command", "licence"} <= card.keys()
        assert (tmp_path / folder / "held_out.json").exists()


def test_tokens_without_held_out_clips_are_refused(tmp_path, tiny_bundle, capsys):
    clips(1)["clip0"].save(tmp_path / "one.npz")
    command = [
        "align",
        "reward-quality",
        str(tmp_path),
        "--bundle",
        str(tiny_bundle),
        "-o",
        str(tmp_path / "q"),
    ]
    assert main(command) == 1
    assert "holds 1 train and 0 test clips" in capsys.readouterr().err
