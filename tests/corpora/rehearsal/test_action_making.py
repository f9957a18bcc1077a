from pathlib import Path

import numpy as np
import pytest

from echoavatar.corpora.rehearsal.action_clips import SCRIPTS, clip
from echoavatar.corpora.rehearsal.action_making import action_from_motion
from echoavatar.engine.pipeline.actions import ActionLibrary
from echoavatar.errors import MotionError
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import HUMANOID, Motion


@pytest.fixture(scope="module")
def tokenizer(tiny_bundle: Path) -> BodyTokenizer:
    return BodyTokenizer.load(tiny_bundle / "tokenizer")


def test_a_clip_becomes_codes_by_the_chunk_and_what_they_leave_out(tokenizer: BodyTokenizer, tmp_path: Path) -> None:
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


@pytest.mark.parametrize(("frames", "name", "complaint"), [(9, "jump", "0.3 s"), (60, "a/b", "cannot name")])
def test_invalid_clips_are_refused(tokenizer: BodyTokenizer, frames: int, name: str, complaint: str) -> None:
    still = np.tile(np.float32([1, 0, 0, 0]), (frames, 52, 1))
    motion = Motion(HUMANOID, still, np.zeros((frames, 3), np.float32), 30.0)
    with pytest.raises(MotionError, match=complaint):
        action_from_motion(tokenizer, name, motion)


def test_the_shipped_library_holds_every_script_and_fits_its_tokenizer() -> None:
    bundle = Path(__file__).parents[3] / "src" / "echoavatar" / "bundles" / "default"
    library = ActionLibrary.load(bundle, 1024)
    assert set(library) == set(SCRIPTS)
    assert library["agree"].overlay is not None
    assert not library["agree"].guides
    assert library["clap"].guides


def palms(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middle knuckles and directions in which the palms look, by frame and side; and the index fingers' tips."""
    made = clip(SCRIPTS[name])
    pose = made.pose()
    hands = [HUMANOID.index(f"{side}Hand") for side in ("left", "right")]
    places = [HUMANOID.index(f"{side}MiddleProximal") for side in ("left", "right")]
    tips = [HUMANOID.index(f"{side}IndexDistal") for side in ("left", "right")]
    facing = pose.rotations[:, hands].numpy() @ np.float32([0, -1, 0])
    return pose.positions[:, places].numpy(), facing, pose.positions[:, tips].numpy()


def test_clapping_palms_meet_and_face_each_other() -> None:
    places, facing, _ = palms("clap")
    apart = np.linalg.norm(places[:, 0] - places[:, 1], axis=1)
    meeting = apart < 0.06
    beats = np.flatnonzero(np.diff(meeting.astype(int)) == 1)
    assert len(beats) == 6
    assert (-(facing[:, 0] * facing[:, 1]).sum(-1)[meeting] > 0.7).all()
    assert (apart[beats[0] : beats[-1]].max()) > 0.15


def test_a_hand_that_thinks_is_at_the_chin_and_one_that_points_stretches_its_index() -> None:
    held = round((SCRIPTS["thinking"].hold[0] + 0.5) * 30)
    pose = clip(SCRIPTS["thinking"]).pose()
    head = pose.positions[held, HUMANOID.index("head")].numpy()
    turn = pose.rotations[held, HUMANOID.index("head")].numpy()
    chin = head + turn @ np.float32([0, -0.035, 0.115])
    thumb_side = pose.positions[held, [HUMANOID.index(f"rightIndex{b}") for b in ("Proximal", "Intermediate")]].numpy()
    assert np.linalg.norm(thumb_side - chin, axis=1).min() < 0.06
    held = round((SCRIPTS["point_left"].hold[0] + 0.5) * 30)
    pose = clip(SCRIPTS["point_left"]).pose()
    from_hand = {
        finger: np.linalg.norm(
            pose.positions[held, HUMANOID.index(f"left{finger}Distal")].numpy()
            - pose.positions[held, HUMANOID.index("leftHand")].numpy()
        )
        for finger in ("Index", "Middle", "Ring", "Little")
    }
    assert from_hand["Index"] > 0.13 > 1.3 * max(from_hand[finger] for finger in ("Middle", "Ring", "Little"))


def test_the_shipped_actions_carry_the_hands_that_their_scripts_declare() -> None:
    bundle = Path(__file__).parents[3] / "src" / "echoavatar" / "bundles" / "default"
    library = ActionLibrary.load(bundle, 1024)
    for name, script in SCRIPTS.items():
        overlay = library[name].overlay
        assert (overlay is not None and len(overlay.hands.joints) > 0) == script.has_hands, name
    pointing = library["point_left"].overlay
    assert pointing is not None
    assert {joint[:4] for joint in pointing.hands.joints} == {"left"}
    assert pointing.hands.shares.max() == 1
    assert pointing.hands.shares[0].max() < 0.05


def test_a_waving_palm_is_open_and_faces_the_viewer() -> None:
    made = clip(SCRIPTS["wave"])
    first, last = (round(second * 30) for second in SCRIPTS["wave"].hold)
    facing = made.pose().rotations[first:last, HUMANOID.index("rightHand")].numpy() @ np.float32([0, -1, 0])
    assert (facing[:, 2] > 0.8).all()
