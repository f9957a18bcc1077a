import numpy as np
import torch

from echoavatar.motion.ik import BodyProfile, RoundedPart
from echoavatar.motion.ik.body import Body
from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics

PROFILE = BodyProfile(
    parts=(
        RoundedPart(bone="chest", centre=(0.0, 0.05, 0.0), radii=(0.2, 0.1, 0.15)),
        RoundedPart(bone="upperChest", centre=(0.0, 0.05, 0.0), radii=(0.2, 0.1, 0.15)),
    )
)


def test_points_on_the_skin_have_length_one() -> None:
    body = Body(HUMANOID, PROFILE)
    rotations = torch.eye(3).repeat(1, HUMANOID.joints, 1, 1)
    turn = [[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # x to -z, z to x
    rotations[0, HUMANOID.index("chest")] = torch.tensor(turn)
    pose = forward_kinematics(HUMANOID, rotations, torch.zeros(1, 3))
    centre = pose.positions[0, HUMANOID.index("chest")].numpy() + [0, 0.05, 0]
    points = np.stack([centre + [0.15, 0, 0], centre + [0, 0.1, 0], centre + [0, 0, 0.2], centre])[None]
    seen = body.to_unit(
        pose.rotations[:, body.joints].numpy(), pose.positions[:, body.joints].numpy(), points.astype(np.float32)
    )
    np.testing.assert_allclose(np.linalg.norm(seen[0, 0], axis=-1), [1, 1, 1, 0], atol=1e-5)


def test_parts_without_a_bone_are_left_out() -> None:
    known = {name: joint for name, joint in HUMANOID.config.vrm.items() if name != "upperChest"}
    body = Body(Skeleton(HUMANOID.config.model_copy(update={"vrm": known})), PROFILE)
    assert [part.bone for part in body.parts] == ["chest"]
