import pytest
import torch

from echoavatar.models.tokenizer import as_one_part
from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics, from_features
from echoavatar_lab.models.tokenizer.planes import PlaneKinematics, finger_joints, travel_columns, wrist_of


def test_planes_give_the_positions_of_forward_kinematics():
    """The same random bodies both ways; the root's travel is left out, its height kept."""
    features = torch.randn(2, 5, 315, generator=torch.Generator().manual_seed(0))
    motion = from_features(HUMANOID, features)
    root = motion.root * torch.tensor([0.0, 1.0, 0.0])
    expected = forward_kinematics(HUMANOID, motion.rotations, root).positions
    found = PlaneKinematics(HUMANOID)(features).permute(2, 3, 1, 0)
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=0)


def test_gradients_agree_with_forward_kinematics():
    features = torch.randn(1, 3, 315, generator=torch.Generator().manual_seed(1))
    weights = torch.randn(1, 3, 52, 3, generator=torch.Generator().manual_seed(2))
    ours, theirs = features.clone().requires_grad_(), features.clone().requires_grad_()
    (PlaneKinematics(HUMANOID)(ours).permute(2, 3, 1, 0) * weights).sum().backward()
    motion = from_features(HUMANOID, theirs)
    root = motion.root * torch.tensor([0.0, 1.0, 0.0])
    (forward_kinematics(HUMANOID, motion.rotations, root).positions * weights).sum().backward()
    torch.testing.assert_close(ours.grad, theirs.grad, atol=1e-4, rtol=1e-3)


def test_travel_ends_the_lower_part():
    assert travel_columns(HUMANOID) == slice(54, 57)


def test_a_rig_with_joints_outside_the_parts_is_refused():
    parts = {"lower": HUMANOID.config.parts["lower"]}
    with pytest.raises(ValueError, match="every joint"):
        PlaneKinematics(Skeleton(HUMANOID.config.model_copy(update={"parts": parts})))


def test_a_finger_hangs_on_its_wrist():
    tip = HUMANOID.index("leftIndexDistal")
    assert wrist_of(HUMANOID, tip) == HUMANOID.index("leftHand")


def test_fingers_are_known_without_their_part():
    assert finger_joints(as_one_part(HUMANOID)) == sorted(HUMANOID.config.parts["hands"])
