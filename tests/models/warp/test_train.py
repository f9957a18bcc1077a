import json
from pathlib import Path

import numpy as np
import torch
from tests.models.warp.tiny import CONFIG, clicks

from echoavatar.models.audio import LevelControl
from echoavatar.models.warp.recipe import WarpTraining
from echoavatar.models.warp.targets import brake_curve
from echoavatar.models.warp.train import train_warp

QUICK = WarpTraining(steps=60, batch=8, frames=64, warmup=5, learning_rate=5e-3, save_every=20)


def test_it_learns_to_brake_behind_clicks_that_it_never_heard(tmp_path: Path) -> None:
    model = train_warp(CONFIG, QUICK, [clicks(480, seed) for seed in range(3)], tmp_path, card={"data": "clicks"})
    clip = clicks(240, seed=77)
    with torch.no_grad():
        heard = model(LevelControl()(torch.from_numpy(clip.audio)[None]))[0].numpy()
    wanted = brake_curve(clip.events, clip.frames)
    assert np.corrcoef(heard[16:], wanted[16:])[0, 1] > 0.7
    told = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert told[-1]["loss"] < 0.8 * told[-1]["blind"]


def test_a_run_that_was_cut_repeats_the_curve_it_would_have_had(tmp_path: Path) -> None:
    clips, short = [clicks()], QUICK.model_copy(update={"steps": 6, "save_every": 2, "batch": 2})
    whole = train_warp(CONFIG, short, clips, tmp_path / "whole")
    train_warp(CONFIG, short, clips, tmp_path / "cut", minutes=0.0)
    cut = train_warp(CONFIG, short, clips, tmp_path / "cut")
    for key, value in whole.state_dict().items():
        assert torch.equal(cut.state_dict()[key], value), key
