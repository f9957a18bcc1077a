import numpy as np

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.halfway import BONES, HALFWAY
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_character.bends import BENDS, SHOULDER, bent, eased, girth_kept, sinks
from echoavatar_character.body import Body
from echoavatar_character.surface import Surface


def test_shares_pass_over_the_halfway_bone_and_at_most_four_joints_are_left(body: Body) -> None:
    upper, lower, helper = (BONES.index(f"left{name}") for name in ("UpperArm", "LowerArm", "LowerArmHalfway"))
    weights = np.zeros((5, HUMANOID.joints))
    weights[:, lower] = np.linspace(0, 1, 5)
    weights[:, upper] = 1 - weights[:, lower]
    made = bent(weights, np.tile(body.joint("leftLowerArm"), (5, 1)), body)
    shares = [[1, 0, 0], [0.5, 0.5, 0], [0, 1, 0], [0, 0.5, 0.5], [0, 0, 1]]
    np.testing.assert_allclose(made[:, [upper, helper, lower]], shares)
    whole = bent(body.weights, body.points, body)
    np.testing.assert_allclose(whole.sum(1), 1)
    assert (whole > 0).sum(1).max() <= 4


def test_weights_pass_more_gently_over_a_shoulder_and_are_left_alone_elsewhere(body: Body, whole: Surface) -> None:
    made = eased(whole, body)
    np.testing.assert_allclose(made.sum(1), 1)
    joints = [body.joint(f"{side}UpperArm") for side in ("left", "right")]
    far = np.min([np.linalg.norm(whole.positions - joint, axis=1) for joint in joints], axis=0)
    np.testing.assert_allclose(made[far > SHOULDER], whole.weights[far > SHOULDER])
    arm, ends = HUMANOID.index("leftUpperArm"), whole.quads[:, :2]
    close = (far < SHOULDER / 2)[ends].all(1)
    before, after = (np.abs(np.diff(weights[:, arm][ends[close]], axis=1)).max() for weights in (whole.weights, made))
    assert after < 0.7 * before


def test_bent_arms_keep_more_of_their_girth_than_with_straight_blending() -> None:
    from dataclasses import replace

    character = load_character()
    sources = {HUMANOID.joints + row: BONES.index(name) for row, name in enumerate(HALFWAY)}
    joints = np.concatenate([character.joints, character.joints], 1)
    weights = np.concatenate([character.weights / 2, character.weights / 2], 1)
    for helper, source in sources.items():  # half to the bone, half to its parent: what was there without the helper
        joints[:, :4][character.joints == helper] = source
        joints[:, 4:][character.joints == helper] = HUMANOID.parents[source]
    straight = replace(character, joints=joints, weights=weights)
    for name in BENDS:
        assert girth_kept(character, *BENDS[name]) > girth_kept(straight, *BENDS[name]) + 0.01, name


def test_a_raised_arm_leaves_the_top_of_the_shoulder() -> None:
    assert abs(sinks(load_character(), 150)) < 16
