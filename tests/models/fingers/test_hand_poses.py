import torch
from tests.models.fingers.moving import waving

from echoavatar.models.fingers.hand_poses import FINGERS, finger_rotations, fit_basis, hand_poses
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar_lab.data.clip import mirror_rotations


def test_finger_rotations_inverts_hand_poses() -> None:
    fingers = matrix_from_axis_angle(torch.randn(7, 30, 3))
    torch.testing.assert_close(finger_rotations(hand_poses(fingers)), fingers)


def test_a_mirrored_body_has_its_hands_swapped() -> None:
    turns = waving(20).matrices()
    hands = hand_poses(turns[:, list(FINGERS)])
    mirrored = hand_poses(mirror_rotations(HUMANOID, turns)[:, list(FINGERS)])
    torch.testing.assert_close(mirrored, hands.flip(1))


def test_the_basis_keeps_the_variance_and_normalises_it() -> None:
    """Poses with three dimensions are recovered from three coordinates, but not from two."""
    hands = torch.randn(500, 3) * torch.tensor([1.0, 0.3, 0.1]) @ torch.randn(3, 90) + 1
    three, two = fit_basis(hands, 3), fit_basis(hands, 2)
    torch.testing.assert_close(three.decode(three.encode(hands)), hands, atol=1e-3, rtol=1e-3)
    assert (two.decode(two.encode(hands)) - hands).abs().max() > 0.1
    spread = three.encode(hands).std(0, correction=0)
    torch.testing.assert_close(spread, three.spread, atol=1e-2, rtol=1e-2)
    assert abs(float(spread.square().mean()) - 1) < 0.02
