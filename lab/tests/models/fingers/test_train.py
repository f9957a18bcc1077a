from functools import partial
from pathlib import Path

import pytest
from tests.models.fingers.moving import QUICK, TINY, waving
from tests.models.runs import check_pieces, check_resume, losses

from echoavatar.checkpoint import read_card
from echoavatar.errors import CheckpointError, MotionError
from echoavatar.models.fingers.clips import finger_clip
from echoavatar_lab.models.fingers.train import FingerTask, train_fingers
from echoavatar_lab.training import Loop


def test_a_killed_run_repeats_the_curve_it_would_have_had(tmp_path: Path) -> None:
    clips, recorded = [finger_clip(waving())], [finger_clip(waving(30, 1))]
    train = partial(train_fingers, TINY, QUICK, clips, recorded=recorded, card={"data": "waving"})
    check_resume(train, tmp_path, at=3)
    card = read_card(tmp_path / "killed")
    assert (card["data"], card["kind"], card["step"]) == ("waving", "fingers", 6)


def test_pieces_share_one_trajectory() -> None:
    """Four windows at once or one by one, some with a known hand and some with a frozen one."""
    clips = [finger_clip(waving()), finger_clip(waving(seed=1, still=("left",)))]

    def make(pieces: int) -> FingerTask:
        return FingerTask(TINY, QUICK.model_copy(update={"accumulation": pieces, "one_known": 0.5}), clips)

    check_pieces(make, 4)


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
    assert losses(tmp_path) == {}
    train_fingers(TINY, QUICK, clips, tmp_path)
    assert len(losses(tmp_path)) == 6


def test_clips_with_frozen_fingers_are_refused() -> None:
    with pytest.raises(MotionError, match="no clip has fingers that move"):
        FingerTask(TINY, QUICK, [finger_clip(waving(still=("left", "right")))])


def test_training_lowers_the_loss(trained: Path) -> None:
    curve = list(losses(trained).values())
    assert sum(curve[-20:]) < 0.5 * sum(curve[:20])
