import torch

from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion


def naive(skeleton, rotations, root):
    """Joint after joint, as the definition says."""
    turns, places = [rotations[0]], [root]
    for joint in range(1, skeleton.joints):
        parent = skeleton.parents[joint]
        places.append(places[parent] + turns[parent] @ skeleton.offsets[joint].to(root))
        turns.append(turns[parent] @ rotations[joint])
    return torch.stack(turns), torch.stack(places)


def random_pose(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    rotations = matrix_from_quaternion(torch.randn(*shape, 52, 4, generator=generator).double())
    return rotations, torch.randn(*shape, 3, generator=generator).double()


def test_levels_give_what_the_definition_gives():
    rotations, root = random_pose(2, 3)
    pose = forward_kinematics(HUMANOID, rotations, root)
    for row in range(2):
        for t in range(3):
            turns, places = naive(HUMANOID, rotations[row, t], root[row, t])
            torch.testing.assert_close(pose.rotations[row, t], turns)
            torch.testing.assert_close(pose.positions[row, t], places)


def test_any_order_of_joints_will_do():
    """Two branches interleaved: 0-1-3-4 and 0-2."""
    offsets = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.5, 0.0, 0.0))
    skeleton = Skeleton(SkeletonConfig(names=tuple("abcde"), parents=(-1, 0, 0, 1, 3), offsets=offsets))
    generator = torch.Generator().manual_seed(1)
    rotations = matrix_from_quaternion(torch.randn(5, 4, generator=generator).double())
    root = torch.tensor([1.0, 2.0, 3.0]).double()
    pose = forward_kinematics(skeleton, rotations, root)
    turns, places = naive(skeleton, rotations, root)
    torch.testing.assert_close(pose.positions, places)
    torch.testing.assert_close(pose.rotations, turns)


def test_rest_pose_is_the_rest_pose():
    rotations = torch.eye(3).expand(52, 3, 3)
    pose = forward_kinematics(HUMANOID, rotations, HUMANOID.offsets[0])
    torch.testing.assert_close(pose.positions, HUMANOID.rest_positions)


def test_gradients_are_the_true_ones():
    rotations, root = random_pose(1)
    chain = [HUMANOID.index(name) for name in ("hips", "leftUpperLeg", "leftLowerLeg", "leftFoot", "leftToes")]
    small = Skeleton(
        SkeletonConfig(
            names=tuple("abcde"),
            parents=(-1, 0, 1, 2, 3),
            offsets=tuple(HUMANOID.config.offsets[joint] for joint in chain),
        )
    )
    inputs = (rotations[:, chain].clone().requires_grad_(), root.clone().requires_grad_())
    assert torch.autograd.gradcheck(lambda r, p: forward_kinematics(small, r, p).positions, inputs)
