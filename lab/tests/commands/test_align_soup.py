"""`echoavatar align soup` mixes what it is told to, and says what it is made of."""

import json

import torch

from echoavatar.cli import main
from echoavatar.models.generator import Generator


def test_a_soup_of_two_runs(tmp_path, tiny_bundle, capsys):
    start = Generator.load(tiny_bundle / "generator")
    for name, by in (("a", 1.0), ("b", 2.0)):
        tuned = Generator(start.config)
        tuned.load_state_dict({key: value + by for key, value in start.state_dict().items()})
        tuned.save(tmp_path / name, {"kind": "generator", "licence": "CC0-1.0", "step": 3})
    shares = {str(tmp_path / "a"): 0.5, str(tmp_path / "b"): 0.25}
    words = [f"{run}={share}" for run, share in shares.items()]
    assert main(["align", "soup", *words, "-o", str(tmp_path / "mix"), "--model", str(tiny_bundle)]) == 0
    assert "2 runs mixed in" in capsys.readouterr().out
    card = json.loads((tmp_path / "mix" / "card.json").read_text())
    assert (card["shares"], card["licence"]) == (shares, "CC0-1.0")
    mixed = Generator.load(tmp_path / "mix")
    torch.testing.assert_close(mixed.lm_head.weight, start.lm_head.weight + 1.0)
    assert main(["align", "soup", str(tmp_path / "a"), "-o", str(tmp_path / "bad"), "--model", str(tiny_bundle)]) == 1
    assert "a' is not NAME=WEIGHT, such as runs/a=0.5" in capsys.readouterr().err
