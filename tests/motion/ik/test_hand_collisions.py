"""The compiled loop of the hand collisions: its map of space in plain words, and frames that do not meet."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.files.avatar.weights import humanoid_weights
from tests.motion.ik.poses import ARM, kept_out, left_wrist_at, pushed_inwards, wrists

from echoavatar.files.avatar import MATERIALS, load_character, skin
from echoavatar.motion.ik import BodyProfile, HandCollisions, RoundedPart
from echoavatar.motion.ik.hand_collisions import ACROSS, BEHIND, CLEARANCE, KNUCKLES, SHELL, Body, hand_points
from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_axis_angle, quaternion_from_matrix
from echoavatar_lab.data.faults import FINGER_JOINTS, penetration_depth_m


def places(bones: dict[str, int], joints: Sequence[str] = KNUCKLES) -> np.ndarray:
    rest = HUMANOID.rest_positions
    points = hand_points(HUMANOID, bones, "left", joints)
    return np.array([rest[point.joint] + point.offset for point in points])


def test_points_reach_from_the_wrist_to_the_fingertips() -> None:
    """In the rest pose the left hand lies along +X; the middle finger ends 0.184 m from the wrist."""
    found = places(bone_map(HUMANOID))
    wrist = HUMANOID.rest_positions[HUMANOID.index("leftHand")]
    np.testing.assert_allclose(found[0], wrist, atol=1e-6)
    assert 0.03 < found[1, 0] - wrist[0] < 0.06
    assert np.isclose(found[:, 0].max() - wrist[0], 0.090 + 0.044 + 0.027 + 0.023, atol=1e-6)
    assert len(places(bone_map(HUMANOID), FINGER_JOINTS)) == 2 + 14 + 5  # without the root of the thumb


def test_a_hand_without_fingers_still_has_length() -> None:
    bones = {name: joint for name, joint in bone_map(HUMANOID).items() if name.endswith(("Hand", "LowerArm"))}
    found = places(bones)
    assert len(found) == 3
    assert 0.15 < found[-1, 0] - found[0, 0] < 0.20


PROFILE = BodyProfile(
    parts=(
        RoundedPart(bone="chest", centre=(0.0, 0.05, 0.0), radii=(0.2, 0.1, 0.15)),
        RoundedPart(bone="upperChest", centre=(0.0, 0.05, 0.0), radii=(0.2, 0.1, 0.15)),
    )
)


def test_parts_without_a_bone_are_left_out() -> None:
    known = {name: joint for name, joint in HUMANOID.config.vrm.items() if name != "upperChest"}
    body = Body(Skeleton(HUMANOID.config.model_copy(update={"vrm": known})), PROFILE)
    assert [part.bone for part in body.parts] == ["chest"]


PLACES = np.array([[0.10, 0.10, 0.10], [0.05, 0.30, 0.12], [0.14, 0.0, 0.12], [0.2, 0.2, 0.16], [0.5, 0.2, 0.2]])


def moved_as_the_text_says(rotations: np.ndarray) -> np.ndarray:
    """By how much each left hand (t, 3) is moved: parts, points and eighth powers one at a time, double precision."""
    collisions = HandCollisions(HUMANOID)
    pose = forward_kinematics(HUMANOID, rotations.astype(np.float64), np.zeros((len(rotations), 3)))
    turns, joints = pose.rotations, pose.positions
    hand = collisions._hands[0]
    thick = np.array([collisions.profile.palm if point.is_palm else collisions.profile.finger for point in hand])
    moves = []
    for turn, joint in zip(turns, joints, strict=True):
        points = [joint[p.joint] + turn[p.joint] @ p.offset for p in hand]
        seen, way = [], np.zeros(3)
        for part in collisions.profile.parts:
            bone = HUMANOID.index(part.bone)
            radii = np.array(part.radii) + thick.min() + CLEARANCE
            axes, middle = turn[bone].T / radii[:, None], np.array(part.centre) / radii
            own = [axes @ (point - joint[bone]) - middle for point in points]
            start = np.array([-ACROSS * part.radii[0], 0, -BEHIND * part.radii[2]])
            away = own[1] * radii - start
            away[1] = max(own[1][1] * radii[1], 0) if part.bone == "head" else 0
            way = way + turn[bone] @ away / (own[1] @ own[1] + 0.25) ** 3
            seen.append((axes, own))
        way /= np.linalg.norm(way)
        reached = 0.0
        for axes, own in seen:
            ahead = axes @ way
            for place, extra in zip(own, thick - thick.min(), strict=True):
                a, b, c = ahead @ ahead, ahead @ place, place @ place - 1
                if b * b > a * c:
                    out = (np.sqrt(b * b - a * c) - b) / a + extra
                    short = np.clip(out + SHELL, 0, 2 * SHELL) ** 2 / (4 * SHELL) + max(out - SHELL, 0)
                    reached += (short / SHELL) ** 8
        moves.append(way * SHELL * reached**0.125)
    return np.array(moves)


def resolved(rotations: np.ndarray) -> np.ndarray:
    return kept_out(HandCollisions(HUMANOID), rotations[None])[0]


def test_a_hand_moves_as_the_text_says() -> None:
    poses = left_wrist_at(PLACES)
    wrist = HUMANOID.index("leftHand")
    before, after = (
        forward_kinematics(HUMANOID, r, np.zeros((len(r), 3), np.float32)).positions[:, wrist]
        for r in (poses, resolved(poses))
    )
    wanted = moved_as_the_text_says(poses)
    assert np.linalg.norm(wanted, axis=1)[:3].min() > 0.008
    np.testing.assert_allclose(after - before, wanted, atol=2e-4)
    assert np.array_equal(before[-1], after[-1])


@pytest.mark.parametrize(("x", "y"), [(0.1, 0.2), (0.12, 0.3), (0.05, 0.25)])
def test_a_hand_on_its_way_to_the_body_is_slowed_over_some_centimetres(x: float, y: float) -> None:
    """Straight to the chest: from where it first yields to where it goes no further it is slowed over 4 to 7 cm."""
    ahead = np.arange(0.30, 0.06, -0.002)
    poses = left_wrist_at(np.stack([np.full_like(ahead, x), np.full_like(ahead, y), ahead], -1))
    wrist = HUMANOID.index("leftHand")
    before, after = (
        forward_kinematics(HUMANOID, r, np.zeros((len(r), 3), np.float32)).positions[:, wrist]
        for r in (poses, resolved(poses))
    )
    yields = np.linalg.norm(after - before, axis=-1)
    first, last = np.argmax(yields > 5e-4), np.argmax(np.diff(yields) > 0.9 * 0.002)
    assert 0.04 < before[first, 2] - before[last, 2] < 0.07


def test_frames_do_not_meet() -> None:
    """One frame of eight inside the body: the other seven keep every bit, and it moves as if it were alone."""
    far, near = left_wrist_at(PLACES[-1:]), left_wrist_at(PLACES[:1])
    mixed = np.tile(far, (8, 1, 1, 1))
    mixed[3] = near
    mixed, alone = (quaternion_from_matrix(given)[None] for given in (mixed, near))
    before = mixed.copy()
    collisions = HandCollisions(HUMANOID)
    for given in (mixed, alone):
        collisions.resolve(given)
    others = [0, 1, 2, 4, 5, 6, 7]
    assert np.array_equal(mixed[:, others], before[:, others])
    assert not np.array_equal(mixed[:, 3], before[:, 3])
    assert np.array_equal(mixed[:, 3], alone[:, 0])


@pytest.fixture(scope="module")
def collisions() -> HandCollisions:
    return HandCollisions(HUMANOID)


@pytest.fixture(scope="module")
def inwards() -> np.ndarray:
    return pushed_inwards()


def line(start: tuple[float, float, float], end: tuple[float, float, float], step: float) -> np.ndarray:
    a, b = np.array(start), np.array(end)
    return a + (b - a) * np.linspace(0, 1, int(np.linalg.norm(b - a) / step))[:, None]


def random_poses(frames: int) -> np.ndarray:
    generator = np.random.default_rng(0)
    turns = (generator.standard_normal((frames, HUMANOID.joints, 3)) * 0.4).astype(np.float32)
    turns[:, HUMANOID.indices([s + n for s in ("left", "right") for n in ("UpperArm", "LowerArm")])] *= 3
    return matrix_from_axis_angle(turns)


def test_hands_outside_stay_bit_for_bit(collisions: HandCollisions) -> None:
    spread = matrix_from_axis_angle(np.zeros((1, 8, HUMANOID.joints, 3), np.float32))
    assert np.array_equal(kept_out(collisions, spread), spread)
    one = spread.copy()
    one[0, 3] = left_wrist_at(np.array([[0.05, 0.2, 0.05]]))[0]
    out = kept_out(collisions, one)
    assert not np.array_equal(out[0, 3], one[0, 3])
    others = [0, 1, 2, 4, 5, 6, 7]
    assert np.array_equal(out[0, others], one[0, others])
    still = [joint for joint in range(HUMANOID.joints) if joint not in ARM[1:]]
    assert np.array_equal(out[:, :, still], one[:, :, still])


def test_gestures_pushed_inwards_come_out_whole(collisions: HandCollisions, inwards: np.ndarray) -> None:
    """Before: hands centimetres deep. After: at most 5 mm, by every joint and tip of every finger."""
    before = penetration_depth_m(HUMANOID, inwards)
    out = kept_out(collisions, inwards[None])[0]
    after = penetration_depth_m(HUMANOID, out)
    assert before.max() > 0.05
    assert (before > 0.005).sum() > 100
    assert after.max() <= 0.005
    moved = np.linalg.norm(wrists(out) - wrists(inwards), axis=-1)
    assert moved[before == 0].max() < 0.05  # the shell
    np.testing.assert_allclose(out.mT @ out, np.broadcast_to(np.eye(3, dtype=np.float32), out.shape), atol=1e-4, rtol=0)


def test_wrist_paths_stay_as_smooth_as_they_were(collisions: HandCollisions, inwards: np.ndarray) -> None:
    def jerk(rotations: np.ndarray) -> np.ndarray:
        return np.linalg.norm(np.diff(wrists(rotations), n=3, axis=0), axis=-1).mean()

    assert jerk(kept_out(collisions, inwards[None])[0]) < 1.5 * jerk(inwards)


def test_random_poses_come_out_too(collisions: HandCollisions) -> None:
    """Twisted spines and arms through anything; in a few no arm is long enough for any way out."""
    poses = random_poses(1500)
    before = penetration_depth_m(HUMANOID, poses)
    after = penetration_depth_m(HUMANOID, kept_out(collisions, poses[None])[0])
    assert (before > 0.005).astype(np.float32).mean() > 0.10
    assert (after > 0.005).astype(np.float32).mean() < 0.005
    assert after.max() < 0.4 * before.max()


def test_the_skin_itself_says_so(collisions: HandCollisions) -> None:
    """Outside witness: the shipped character's skinned hands against its skinned torso and head, by nearest normal."""
    character = load_character()
    owner = humanoid_weights(character).argmax(1)
    hands = np.isin(owner, [i for i, n in enumerate(HUMANOID.names) if n.startswith("left") and i in range(9, 25)])
    trunk = np.isin(owner, HUMANOID.indices(["hips", "spine", "chest", "upperChest", "neck", "head"]))
    trunk &= ~np.array([material.name in ("hair", "lash") for material in MATERIALS])[character.materials]
    outwards = character.positions - HUMANOID.rest_positions[owner]
    trunk &= (outwards * character.normals)[:, [0, 2]].sum(1) > 0  # not the inside of a hem

    def depth(rotations: np.ndarray) -> float:
        pose = forward_kinematics(HUMANOID, rotations, np.zeros(3, np.float32))
        vertices, normals = skin(character, pose.rotations, pose.positions)
        away, nearest = cKDTree(vertices[trunk]).query(vertices[hands], distance_upper_bound=0.08)
        found = np.isfinite(away)
        gap = vertices[hands][found] - vertices[trunk][nearest[found]]
        height = (gap * normals[trunk][nearest[found]]).sum(1)
        return float(max(-height.min(initial=0), 0))

    places = np.array([[0.10, 0.10, 0.06], [0.05, 0.30, 0.08], [0.12, 0.0, 0.08], [0.03, 0.66, 0.08]])
    poses = left_wrist_at(places)
    out = kept_out(collisions, poses[None])[0]
    assert min(depth(pose) for pose in poses) > 0.015
    assert max(depth(pose) for pose in out) < 0.005


@pytest.mark.parametrize(
    ("start", "end"),
    [
        pytest.param((0.40, 0.2, 0.0), (-0.15, 0.2, 0.0), id="across the axis"),
        pytest.param((0.05, 0.2, 0.40), (0.05, 0.2, -0.08), id="from ahead to behind the axis"),
        pytest.param((0.0, 0.0, 0.0), (0.0, 0.6, 0.0), id="up along the axis"),
        pytest.param((0.01, 0.0, 0.20), (0.01, 0.7, 0.20), id="up along the front"),
        pytest.param((0.3, 0.62, 0.1), (-0.05, 0.70, 0.05), id="into the face"),
        pytest.param((0.05, 0.9, 0.05), (0.05, 0.55, 0.05), id="down through the head"),
        pytest.param((0.3, 0.0, 0.0), (0.1, 0.0, -0.02), id="into the hip"),
    ],
)
def test_steps_of_two_millimetres_stay_small(
    collisions: HandCollisions, start: tuple[float, float, float], end: tuple[float, float, float]
) -> None:
    """A smooth map: no step of the wrist over 5 times that asked for, no joint over 3 times its own fastest."""
    poses = left_wrist_at(line(start, end, 0.002))
    out = kept_out(collisions, poses[None])[0]
    asked, got = (np.linalg.norm(np.diff(wrists(r)[:, 0], axis=0), axis=-1).max() for r in (poses, out))
    assert got < 5 * asked
    own, new = (angle_between(r[1:, ARM], r[:-1, ARM]).max() for r in (poses, out))
    assert new < 3 * own
    assert penetration_depth_m(HUMANOID, poses)[:, 0].max() > 0.01
    assert penetration_depth_m(HUMANOID, out)[:, 0].max() == 0


def test_the_hand_keeps_its_orientation_and_reaches_the_distance(collisions: HandCollisions) -> None:
    """The swing alone would leave the hand at its old distance from the shoulder."""
    pose = left_wrist_at(np.array([[0.05, 0.2, 0.02]]))
    out = kept_out(collisions, pose[None])[0]
    before, after = (forward_kinematics(HUMANOID, r, np.zeros((1, 3), np.float32)) for r in (pose, out))
    assert angle_between(before.rotations[0, ARM[3]], after.rotations[0, ARM[3]]) < 1e-3
    far = [np.linalg.norm(p.positions[0, ARM[3]] - p.positions[0, ARM[1]]) for p in (before, after)]
    assert np.abs(far[1] - far[0]) > 0.01


def test_any_chunking_gives_the_whole(collisions: HandCollisions, inwards: np.ndarray) -> None:
    whole = kept_out(collisions, inwards[None])
    for sizes in ([8] * (len(inwards) // 8), [1] * 5 + [len(inwards) - 5]):
        cut = inwards[: sum(sizes)]
        parts = np.concatenate([kept_out(collisions, part[None]) for part in np.split(cut, np.cumsum(sizes)[:-1])], 1)
        np.testing.assert_allclose(parts, whole[:, : len(cut)], atol=2e-6, rtol=0)


def test_a_neighbour_changes_nothing(collisions: HandCollisions, inwards: np.ndarray) -> None:
    one, two, three = inwards[:8], inwards[100:108], random_poses(8)
    a, b = kept_out(collisions, np.stack([one, two])), kept_out(collisions, np.stack([one, three]))
    assert np.array_equal(a[0], b[0])
    assert not np.array_equal(a[1], b[1])


def test_where_the_body_stands_and_faces_does_not_matter(collisions: HandCollisions, inwards: np.ndarray) -> None:
    turned = inwards[None, :64].copy()
    turned[:, :, 0] = matrix_from_axis_angle(np.array([0.3, 2.0, 0.1])) @ turned[:, :, 0]
    assert np.array_equal(kept_out(collisions, turned)[:, :, 1:], kept_out(collisions, inwards[None, :64])[:, :, 1:])


def test_a_rig_without_arms_is_passed_through() -> None:
    stump = {name: joint for name, joint in HUMANOID.config.vrm.items() if "Hand" not in name}
    armless = HandCollisions(Skeleton(HUMANOID.config.model_copy(update={"vrm": stump})))
    rotations = random_poses(4)[None]
    assert not armless.is_able
    assert np.array_equal(kept_out(armless, rotations), rotations)


def test_a_rig_without_fingers_and_upper_chest_is_kept_out_too() -> None:
    known = {
        name: joint
        for name, joint in HUMANOID.config.vrm.items()
        if name != "upperChest" and not name.endswith(("Proximal", "Intermediate", "Distal", "Metacarpal"))
    }
    plain = Skeleton(HUMANOID.config.model_copy(update={"vrm": known}))
    poses = left_wrist_at(line((0.3, 0.1, 0.1), (0.0, 0.2, 0.05), 0.02))
    out = kept_out(HandCollisions(plain), poses[None])[0]
    assert penetration_depth_m(plain, poses).max() > 0.05
    assert penetration_depth_m(plain, out).max() <= 0.005
