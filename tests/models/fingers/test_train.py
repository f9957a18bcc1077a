import json
from pathlib import Path

import pytest
import torch
from tests.models.fingers.moving import QUICK, TINY, waving

from echoavatar.checkpoint import read_card
from echoavatar.errors import CheckpointError, MotionError
from echoavatar.models.fingers.clips import finger_clip
from echoavatar.models.fingers.train import FingerTask, train_fingers
from echoavatar.training import Loop


def losses(folder: Path) -> list[float]:
    return [json.loads(line)["loss"] for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_a_killed_run_repeats_the_curve_it_would_have_had(tmp_path: Path) -> None:
    clips, recorded = [finger_clip(waving())], [finger_clip(waving(30, 1))]
    whole = train_fingers(TINY, QUICK, clips, tmp_path / "whole", recorded=recorded)
    loop = Loop(FingerTask(TINY, QUICK, clips, recorded))
    for _ in range(3):
        loop.advance()
    loop.save(tmp_path / "cut")
    cut = train_fingers(TINY, QUICK, clips, tmp_path / "cut", recorded=recorded, card={"data": "waving"})
    assert losses(tmp_path / "cut") == losses(tmp_path / "whole")[3:]
    for key, value in whole.state_dict().items():
        assert torch.equal(cut.state_dict()[key], value), key
    card = read_card(tmp_path / "cut")
    assert (card["data"], card["kind"], card["step"]) == ("waving", "fingers", 6)


def test_pieces_share_one_trajectory() -> None:
    """Four windows at once or one by one, some with a known hand and some with a frozen one."""
    clips = [finger_clip(waving()), finger_clip(waving(seed=1, still=("left",)))]
    curves = []
    for pieces in (1, 4):
        training = QUICK.model_copy(update={"accumulation": pieces, "one_known": 0.5})
        loop = Loop(FingerTask(TINY, training, clips))
        curves.append([loop.advance()["loss"] for _ in range(5)])
    assert curves[0] == pytest.approx(curves[1], rel=1e-4)


def test_another_schedule_or_size_is_refused(tmp_path: Path) -> None:
    clips = [finger_clip(waving(20))]
    Loop(FingerTask(TINY, QUICK, clips)).save(tmp_path)
    with pytest.raises(CheckpointError, match="another training config: seed"):
        train_fingers(TINY, QUICK.model_copy(update={"seed": 1}), clips, tmp_path)
    with pytest.raises(CheckpointError, match="another fingers config: width"):
        train_fingers(TINY.model_copy(update={"width": 64}), QUICK, clips, tmp_path)


def test_a_run_stops_on_time_and_continues_later(tmp_path: Path) -> None:
    clips = [finger_clip(waving(20))]
    train_fingers(TINY, QUICK, clips, tmp_path, minutes=0.0)
    assert losses(tmp_path) == []
    train_fingers(TINY, QUICK, clips, tmp_path)
    assert len(losses(tmp_path)) == 6


def test_clips_with_frozen_fingers_are_refused() -> None:
    with pytest.raises(MotionError, match="no clip has fingers that move"):
        FingerTask(TINY, QUICK, [finger_clip(waving(still=("left", "right")))])


def test_training_lowers_the_loss(trained: Path) -> None:
    curve = losses(trained)
    assert sum(curve[-20:]) < 0.5 * sum(curve[:20])
