import numpy as np

from echoavatar.ik import BodyProfile, RoundedPart
from echoavatar.ik.body import Body, to_unit
from echoavatar.ik.chains import Chains
from echoavatar.kinematics import HUMANOID, Skeleton

PROFILE = BodyProfile(
    parts=(
        RoundedPart(bone="chest", centre=(0.0, 0.05, 0.0), radii=(0.2, 0.1, 0.15)),
        RoundedPart(bone="upperChest", centre=(0.0, 0.05, 0.0), radii=(0.2, 0.1, 0.15)),
    )
)


def test_points_on_the_skin_have_length_one() -> None:
    body = Body(HUMANOID, PROFILE)
    chains = Chains(HUMANOID, body.joints)
    rotations = np.tile(np.eye(3, dtype=np.float32), (1, HUMANOID.joints, 1, 1))
    turn = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # x to -z, z to x
    rotations[0, HUMANOID.index("chest")] = turn
    frames = chains.world(chains.local(rotations))
    rest = (HUMANOID.rest_positions - HUMANOID.rest_positions[0]).numpy()
    centre = rest[HUMANOID.index("chest")] + [0, 0.05, 0]
    points = np.stack([centre + [0.15, 0, 0], centre + [0, 0.1, 0], centre + [0, 0, 0.2], centre], 1)[
        ..., None
    ]
    seen = to_unit(frames[:, :, body.slots(chains)], body.centres, body.radii, points.astype(np.float32))
    np.testing.assert_allclose(np.linalg.norm(seen[:, 0, :, 0], axis=0), [1, 1, 1, 0], atol=1e-5)


def test_parts_without_a_bone_are_left_out() -> None:
    known = {name: joint for name, joint in HUMANOID.config.vrm.items() if name != "upperChest"}
    body = Body(Skeleton(HUMANOID.config.model_copy(update={"vrm": known})), PROFILE)
    assert [part.bone for part in body.parts] == ["chest"]
