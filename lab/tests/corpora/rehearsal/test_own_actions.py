from pathlib import Path

import numpy as np

from echoavatar.engine.pipeline.actions import ActionLibrary
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS, clip


def test_the_shipped_library_holds_every_script_and_fits_its_tokenizer() -> None:
    bundle = Path(__file__).parents[4] / "src" / "echoavatar" / "bundles" / "default"
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
    facing = pose.rotations[:, hands] @ np.float32([0, -1, 0])
    return pose.positions[:, places], facing, pose.positions[:, tips]


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
    head = pose.positions[held, HUMANOID.index("head")]
    turn = pose.rotations[held, HUMANOID.index("head")]
    chin = head + turn @ np.float32([0, -0.035, 0.115])
    thumb_side = pose.positions[held, [HUMANOID.index(f"rightIndex{b}") for b in ("Proximal", "Intermediate")]]
    assert np.linalg.norm(thumb_side - chin, axis=1).min() < 0.06
    held = round((SCRIPTS["point_left"].hold[0] + 0.5) * 30)
    pose = clip(SCRIPTS["point_left"]).pose()
    from_hand = {
        finger: np.linalg.norm(
            pose.positions[held, HUMANOID.index(f"left{finger}Distal")]
            - pose.positions[held, HUMANOID.index("leftHand")]
        )
        for finger in ("Index", "Middle", "Ring", "Little")
    }
    assert from_hand["Index"] > 0.13 > 1.3 * max(from_hand[finger] for finger in ("Middle", "Ring", "Little"))


def test_the_shipped_actions_carry_the_hands_that_their_scripts_declare() -> None:
    bundle = Path(__file__).parents[4] / "src" / "echoavatar" / "bundles" / "default"
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
    facing = made.pose().rotations[first:last, HUMANOID.index("rightHand")] @ np.float32([0, -1, 0])
    assert (facing[:, 2] > 0.8).all()
