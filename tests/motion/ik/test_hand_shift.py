"""The compiled loop of the hand collisions: its map of space in plain words, and frames that do not meet."""

import numpy as np
import pytest
import torch
from tests.motion.ik.poses import left_wrist_at

from echoavatar.motion.ik import HandCollisions
from echoavatar.motion.ik.hand_collisions import ACROSS, BEHIND, CLEARANCE
from echoavatar.motion.ik.hand_shift import SHELL
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix

PLACES = torch.tensor([[0.10, 0.10, 0.10], [0.05, 0.30, 0.12], [0.14, 0.0, 0.12], [0.2, 0.2, 0.16], [0.5, 0.2, 0.2]])


def moved_as_the_text_says(rotations: torch.Tensor) -> np.ndarray:
    """By how much each left hand (t, 3) is moved: parts, points and eighth powers one at a time, double precision."""
    collisions = HandCollisions(HUMANOID)
    pose = forward_kinematics(HUMANOID, rotations.double(), torch.zeros(len(rotations), 3).double())
    turns, joints = pose.rotations.numpy(), pose.positions.numpy()
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


def resolved(rotations: torch.Tensor) -> torch.Tensor:
    return HandCollisions(HUMANOID).step(rotations[None])[0]


def test_a_hand_moves_as_the_text_says() -> None:
    poses = left_wrist_at(PLACES)
    wrist = HUMANOID.index("leftHand")
    before, after = (
        forward_kinematics(HUMANOID, r, torch.zeros(len(r), 3)).positions[:, wrist].numpy()
        for r in (poses, resolved(poses))
    )
    wanted = moved_as_the_text_says(poses)
    assert np.linalg.norm(wanted, axis=1)[:3].min() > 0.01
    np.testing.assert_allclose(after - before, wanted, atol=2e-4)
    assert np.array_equal(before[-1], after[-1])


@pytest.mark.parametrize(("x", "y"), [(0.1, 0.2), (0.12, 0.3), (0.05, 0.25)])
def test_a_hand_on_its_way_to_the_body_is_slowed_over_some_centimetres(x: float, y: float) -> None:
    """Straight to the chest: from where it first yields to where it goes no further it is slowed over 4 to 7 cm."""
    ahead = torch.arange(0.30, 0.06, -0.002)
    poses = left_wrist_at(torch.stack([torch.full_like(ahead, x), torch.full_like(ahead, y), ahead], -1))
    wrist = HUMANOID.index("leftHand")
    before, after = (
        forward_kinematics(HUMANOID, r, torch.zeros(len(r), 3)).positions[:, wrist].numpy()
        for r in (poses, resolved(poses))
    )
    yields = np.linalg.norm(after - before, axis=-1)
    first, last = np.argmax(yields > 5e-4), np.argmax(np.diff(yields) > 0.9 * 0.002)
    assert 0.04 < before[first, 2] - before[last, 2] < 0.07


def test_frames_do_not_meet() -> None:
    """One frame of eight inside the body: the other seven keep every bit, and it moves as if it were alone."""
    far, near = left_wrist_at(PLACES[-1:]), left_wrist_at(PLACES[:1])
    mixed = far.repeat(8, 1, 1, 1)
    mixed[3] = near
    mixed, alone = (quaternion_from_matrix(given)[None].numpy() for given in (mixed, near))
    before = mixed.copy()
    collisions = HandCollisions(HUMANOID)
    for given in (mixed, alone):
        collisions.resolve(given, collisions._chains.pose(given))
    others = [0, 1, 2, 4, 5, 6, 7]
    assert np.array_equal(mixed[:, others], before[:, others])
    assert not np.array_equal(mixed[:, 3], before[:, 3])
    assert np.array_equal(mixed[:, 3], alone[:, 0])
