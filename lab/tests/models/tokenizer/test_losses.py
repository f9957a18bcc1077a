from types import SimpleNamespace

import numpy as np
import pytest
import torch
from tests.models.motion_tokens import dance

from echoavatar.motion.kinematics import HUMANOID, Skeleton
from echoavatar_lab.kinematics import forward_kinematics, from_features
from echoavatar_lab.models.tokenizer.losses import (
    LossWeights,
    MotionLoss,
    PlaneKinematics,
    finger_joints,
    total,
    wrist_of,
)
from echoavatar_lab.models.tokenizer.train import as_one_part, clip_features


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


def test_a_rig_with_joints_outside_the_parts_is_refused():
    parts = {"lower": HUMANOID.config.parts["lower"]}
    with pytest.raises(ValueError, match="every joint"):
        PlaneKinematics(Skeleton(HUMANOID.config.model_copy(update={"parts": parts})))


def test_a_finger_hangs_on_its_wrist():
    tip = HUMANOID.index("leftIndexDistal")
    assert wrist_of(HUMANOID, tip) == HUMANOID.index("leftHand")


def test_fingers_are_known_without_their_part():
    assert finger_joints(as_one_part(HUMANOID)) == sorted(HUMANOID.config.parts["hands"])


PLAIN = {"mean": torch.zeros(315), "std": torch.ones(315)}
ZERO = dict.fromkeys(LossWeights.model_fields, 0.0)


def features(seed=0, frames=32):
    return clip_features(HUMANOID, dance(seed, frames))[None]


def test_paper_weights_are_the_defaults():
    weights = LossWeights()
    assert (weights.commitment, weights.position, weights.velocity) == (0.5, 0.02, 0.2)
    assert (weights.acceleration, weights.foot_velocity, weights.foot_position) == (0.2, 0.3, 0.05)
    assert (weights.travel, weights.planted, weights.root, weights.fingers, weights.turn) == (0, 0, 0, 0, 0)


def test_perfect_reconstruction_costs_nothing():
    x = features()
    weights = LossWeights(travel=1, planted=1, root=1, fingers=1, turn=1)
    assert total(MotionLoss(HUMANOID, weights)(x, x, **PLAIN)).item() == pytest.approx(0, abs=1e-6)


def test_a_raised_root_costs_its_height_in_centimetres():
    """2 cm too high on every frame: each joint is off by 2 cm on one axis of three, and nothing changes in time."""
    x = features()
    raised = x.clone()
    raised[..., 56] += 0.02
    terms = MotionLoss(HUMANOID, LossWeights(position=1, foot_position=1))(raised, x, **PLAIN)
    assert terms["position"].item() == pytest.approx(2 / 3, rel=1e-3)
    assert terms["foot_position"].item() == pytest.approx(2 / 3, rel=1e-3)
    assert terms["velocity"].item() == pytest.approx(0, abs=1e-4)


def test_velocity_and_acceleration_of_a_single_raised_frame():
    """One of 32 frames 3 cm up: two velocity errors of 3 cm in 31, one of 6 and two of 3 in 30, on one axis of 3."""
    x = features()
    raised = x.clone()
    raised[:, 10, 56] += 0.03
    terms = MotionLoss(HUMANOID, LossWeights(velocity=1, acceleration=1))(raised, x, **PLAIN)
    assert terms["velocity"].item() == pytest.approx(6 / 31 / 3, rel=1e-3)
    assert terms["acceleration"].item() == pytest.approx(12 / 30 / 3, rel=1e-3)


def test_drift_costs_its_integral():
    """1 cm per frame along x for 32 frames: the path is off by 1, 2, ... 32 cm, 16.5 on average, on one of two axes."""
    x = features()
    drifting = x.clone()
    drifting[..., 54] += 0.01
    terms = MotionLoss(HUMANOID, LossWeights(**{**ZERO, "travel": 1.0}))(drifting, x, **PLAIN)
    assert terms["travel"].item() == pytest.approx(16.5 / 2, rel=1e-3)


def test_shoulders_that_turn_less_cost_what_they_lack():
    """The spine turns by 10 degrees each way or by 4; turned the other way or with the body, it lacks nothing."""

    def body(turn: float, heading: float = 0.0):
        angles = np.radians(np.resize([-1.0, 1.0], 32) * turn)
        rotations = np.tile(np.array([1.0, 0, 0, 0], np.float32), (32, HUMANOID.joints, 1))
        rotations[:, HUMANOID.index("spine")] = np.stack([np.cos(angles / 2), *3 * [0 * angles]], 1)
        rotations[:, HUMANOID.index("spine"), 2] = np.sin(angles / 2)
        rotations[:, 0, 0], rotations[:, 0, 2] = np.cos(heading / 2), np.sin(heading / 2)
        root = np.tile(HUMANOID.rest_positions[0], (32, 1))
        return clip_features(HUMANOID, SimpleNamespace(rotations=rotations, root=root))[None]

    loss = MotionLoss(HUMANOID, LossWeights(**{**ZERO, "turn": 1.0}))
    terms = [loss(decoded, body(10), **PLAIN)["turn"].item() for decoded in (body(4), body(-10), body(10, heading=2.5))]
    assert terms == pytest.approx([6 * (32 / 31) ** 0.5, 0, 0], abs=0.05)


def test_turn_needs_shoulders_and_hips():
    vrm = {bone: joint for bone, joint in HUMANOID.config.vrm.items() if bone != "leftUpperArm"}
    armless = Skeleton(HUMANOID.config.model_copy(update={"vrm": vrm}))
    MotionLoss(armless, LossWeights())
    with pytest.raises(ValueError, match="lacks leftUpperArm, which the loss `turn` needs"):
        MotionLoss(armless, LossWeights(turn=1))


def test_only_standing_feet_count_as_planted():
    """A body at rest slides 1 cm per frame: all feet slip by 1. A body that truly moves so has no planted foot."""
    still = features()[:, :1].repeat(1, 32, 1)
    still[..., 54:56] = 0
    sliding = still.clone()
    sliding[..., 54] = 0.01
    loss = MotionLoss(HUMANOID, LossWeights(**{**ZERO, "planted": 1.0}))
    assert loss(sliding, still, **PLAIN)["planted"].item() == pytest.approx(1.0, rel=1e-3)
    assert loss(still, sliding, **PLAIN)["planted"].item() == 0


def test_the_loss_reaches_every_part():
    x = features()
    guess = (x + 0.01 * torch.randn(x.shape, generator=torch.Generator().manual_seed(0))).requires_grad_()
    total(MotionLoss(HUMANOID, LossWeights())(guess, x, **PLAIN)).backward()
    assert all(part.abs().sum() > 0 for part in guess.grad.split([57, 78, 180], -1))


def test_finger_errors_are_seen_from_the_wrist():
    """A raised body moves fingers and wrists alike: no finger error."""
    x = features()
    raised = x.clone()
    raised[..., 56] += 0.02
    terms = MotionLoss(HUMANOID, LossWeights(fingers=1))(raised, x, **PLAIN)
    assert terms["fingers"].item() == pytest.approx(0, abs=1e-4)
    bent = x.clone()
    bent[..., 135:141] = torch.tensor([1.0, 0, 0, 0, 0, 1.0])
    assert MotionLoss(HUMANOID, LossWeights(fingers=1))(bent, x, **PLAIN)["fingers"].item() > 0
