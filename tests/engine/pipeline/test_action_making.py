from pathlib import Path

import numpy as np
import pytest

from echoavatar.engine.pipeline.action_making import action_from_motion
from echoavatar.engine.pipeline.actions import ActionLibrary
from echoavatar.errors import MotionError
from echoavatar.models.clip_tokenizer import ClipTokenizer
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS, clip
from echoavatar_lab.models.tokenizer.model import BodyTokenizer


@pytest.fixture(scope="module")
def tokenizer(tiny_bundle: Path) -> ClipTokenizer:
    return BodyTokenizer.load(tiny_bundle / "tokenizer").clips()


def test_a_clip_becomes_codes_by_the_chunk_and_what_they_leave_out(tokenizer: ClipTokenizer, tmp_path: Path) -> None:
    """A nod of 3 s is 12 chunks; a tokenizer of random weights says nothing of it, so the head's turn is kept."""
    nod = clip(SCRIPTS["agree"])
    action = action_from_motion(tokenizer, "Nod Twice", nod, hold_s=(0.5, 1.2))
    assert action.name == "nod_twice"
    assert action.chunks == -(-nod.frames // 8)
    assert action.hold == (2, 4)
    assert action.overlay is not None
    assert "head" in action.overlay.joints
    ActionLibrary({"nod_twice": action}).save(tmp_path)
    assert len(ActionLibrary.load(tmp_path, 8)["nod_twice"].codes) == 2 * action.chunks


def still(frames: int) -> Motion:
    return Motion(HUMANOID, np.tile(np.float32([1, 0, 0, 0]), (frames, 52, 1)), np.zeros((frames, 3), np.float32), 30.0)


@pytest.mark.parametrize(("frames", "name", "complaint"), [(9, "jump", "0.3 s"), (60, "a/b", "cannot name")])
def test_invalid_clips_are_refused(tokenizer: ClipTokenizer, frames: int, name: str, complaint: str) -> None:
    with pytest.raises(MotionError, match=complaint):
        action_from_motion(tokenizer, name, still(frames))


def test_a_clip_may_last_half_a_second_to_twenty(tokenizer: ClipTokenizer) -> None:
    for frames in (15, 600):
        assert action_from_motion(tokenizer, "rest", still(frames)).chunks == -(-frames // 8)
    for frames in (14, 601):
        with pytest.raises(MotionError, match="cannot be an action"):
            action_from_motion(tokenizer, "rest", still(frames))
