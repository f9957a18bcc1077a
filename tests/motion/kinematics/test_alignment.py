import math

import torch
from tests.motion.kinematics.samples import swaying

from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics
from echoavatar.motion.kinematics.alignment import align, project_rotation
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar_lab.corpora.solver import matrix_from_euler


def test_the_nearest_rotation_of_a_rotation_is_itself():
    turns = matrix_from_quaternion(torch.randn(20, 4, generator=torch.Generator().manual_seed(1)).double())
    torch.testing.assert_close(project_rotation(turns * 0.4), turns)
    flat = torch.diag(torch.tensor([1.0, 1.0, -0.1]).double())
    torch.testing.assert_close(project_rotation(flat).det(), torch.tensor(1.0).double())


def test_a_rig_fits_itself():
    motion = swaying(10, size=0.0)
    turns = motion.matrices().double()
    pose = forward_kinematics(HUMANOID, turns, torch.from_numpy(motion.root).double())
    for turn in align(HUMANOID, pose, HUMANOID.config.vrm, HUMANOID, HUMANOID.config.vrm).values():
        torch.testing.assert_close(turn, torch.eye(3).double(), atol=1e-6, rtol=0)


def test_an_a_pose_is_met_by_turning_the_arms():
    """Arms that rest 45 degrees lower in the source: its zero rotation is our arm turned down by 45 degrees."""
    lowered = matrix_from_euler(torch.tensor([-math.pi / 4, 0, 0]), "zyx")
    offsets = [list(offset) for offset in HUMANOID.config.offsets]
    for joint, name in enumerate(HUMANOID.names):
        if name.startswith("left") and any(
            p in name for p in ("LowerArm", "Hand", "Thumb", "Index", "Middle", "Ring", "Little")
        ):
            offsets[joint] = (lowered @ torch.tensor(offsets[joint])).tolist()
    source = Skeleton(
        HUMANOID.config.model_copy(update={"tips": {}, "offsets": tuple(tuple(offset) for offset in offsets)})
    )
    pose = forward_kinematics(
        source, torch.eye(3).expand(4, 52, 3, 3).double(), source.offsets[0].double().expand(4, 3)
    )
    found = align(source, pose, source.config.vrm, HUMANOID, HUMANOID.config.vrm)
    torch.testing.assert_close(found["leftUpperArm"], lowered.double(), atol=1e-5, rtol=0)
    torch.testing.assert_close(found["leftIndexIntermediate"], lowered.double(), atol=2e-2, rtol=0)
    torch.testing.assert_close(found["rightUpperArm"], torch.eye(3).double(), atol=1e-6, rtol=0)
