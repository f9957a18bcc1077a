"""The learned rewards from the command line."""

import json

import numpy as np
import pytest
import torch
from lab.tests.align.tuning_fakes import clips, save_clips

from echoavatar.cli import main
from echoavatar_lab.align.audio_encoders import Beats, BeatsConfig, Wav2Clip, Wav2ClipConfig
from echoavatar_lab.align.audio_reward import AudioMotion


@pytest.mark.slow
def test_each_reward_is_trained_measured_and_written(tmp_path, tiny_bundle, capsys):
    tokens = save_clips(tmp_path / "tokens", 4, 16, held_out=True)
    common = [str(tokens), "--model", str(tiny_bundle)]
    scores, quality, alignment = (str(tmp_path / name) for name in ("scores.json", "quality", "alignment"))
    assert main(["align", "calibrate", *common, "-o", scores, "--windows", "2"]) == 0
    small = ["--steps", "2", "--width", "16"]
    assert main(["align", "reward-quality", *common, "-o", quality, "--scores", scores, "--windows", "2", *small]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert np.isfinite(found["pearson_levels"])
    assert main(["align", "reward-alignment", *common, "-o", alignment, *small]) == 0
    table = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert table["everything"]["audio to motion, all"]["gallery"] == 1
    read = str(tmp_path / "read")
    assert main(["align", "reward-alignment", *common, "-o", read, *small, "--motion", "features"]) == 0
    assert AudioMotion.load(tmp_path / "read").config.motion == "features"
    for folder in (quality, alignment):
        card = json.loads((tmp_path / folder / "card.json").read_text())
        assert {"data", "command", "licence"} <= card.keys()
        assert (tmp_path / folder / "held_out.json").exists()


def two_clips(tmp_path):
    return save_clips(tmp_path / "tokens", 2, 16, held_out=True)


def test_beats_and_wav2clip_hear_with_published_weights_which_are_left_as_they_are(tmp_path, tiny_bundle, capsys):
    """Random weights in the published files' layout, at a small size."""
    beats = Beats(BeatsConfig(layers=1, width=16, heads=2, hidden=24, patch_width=8, reach=4, groups=2))
    wav2clip = Wav2Clip(Wav2ClipConfig(width=4, blocks=1))
    named = {f"audio_encoder.{name}": value for name, value in wav2clip.state_dict().items()}
    torch.save({"cfg": {"encoder_layers": 1}, "model": beats.state_dict()}, tmp_path / "beats.pt")
    torch.save({"state_dict": named, "epoch": 3}, tmp_path / "wav2clip.pt")
    common = [str(two_clips(tmp_path)), "--model", str(tiny_bundle), "--steps", "2", "--batch", "4", "--width", "16"]
    for kind, own in (("beats", beats), ("wav2clip", wav2clip)):
        folder, weights = tmp_path / kind, str(tmp_path / f"{kind}.pt")
        command = ["align", "reward-alignment", *common, "-o", str(folder), "--encoder", kind]
        assert main([*command, "--encoder-weights", weights]) == 0
        table = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert "audio to motion, all" in table["everything"]
        kept = AudioMotion.load(folder).audio_encoder.network.state_dict()
        assert all(torch.equal(value, kept[name]) for name, value in own.state_dict().items())


class Hostile:
    def __reduce__(self):
        return print, ("ran",)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (None, "is missing"),
        (b"PK\x03\x04 cut off", "is damaged, cut off"),
        ({"model": {"a": Hostile()}}, "is refused: it would run"),
        ({"weights": {}}, "has no entry 'model'"),
        ({"model": {"a": torch.zeros(2)}}, "these are not BEATs weights"),
    ],
)
def test_files_that_are_no_weights_are_named_and_never_run(tmp_path, tiny_bundle, capsys, made, message):
    path = tmp_path / "beats.pt"
    if isinstance(made, bytes):
        path.write_bytes(made)
    elif made is not None:
        torch.save(made, path)
    command = ["align", "reward-alignment", str(two_clips(tmp_path)), "--model", str(tiny_bundle), "-o"]
    assert main([*command, str(tmp_path / "o"), "--encoder", "beats", "--encoder-weights", str(path)]) == 1
    told = capsys.readouterr()
    assert message in told.err
    assert "ran" not in told.out.split()


def test_weights_without_their_encoder_are_refused(tmp_path, tiny_bundle, capsys):
    command = ["align", "reward-alignment", str(two_clips(tmp_path)), "--model", str(tiny_bundle), "-o"]
    assert main([*command, str(tmp_path / "o"), "--encoder-weights", "beats.pt"]) == 1
    assert "name one of them" in capsys.readouterr().err


def test_tokens_without_held_out_clips_are_refused(tmp_path, tiny_bundle, capsys):
    clips(1)["clip0"].save(tmp_path / "one.npz")
    command = ["align", "reward-quality", str(tmp_path), "--model", str(tiny_bundle), "-o", str(tmp_path / "q")]
    assert main(command) == 1
    assert "holds no clip of split test, on which reward-quality is measured" in capsys.readouterr().err
