from dataclasses import replace

import numpy as np
import pytest

from echoavatar.motion.kinematics import HUMANOID, Pose, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar_lab.corpora.controls import Controls, mirrored, neutral
from echoavatar_lab.corpora.gesture.handshapes import hand_shape
from echoavatar_lab.corpora.solver import solve


def posed(controls: Controls) -> Pose:
    quaternions, root = solve(controls)
    return forward_kinematics(HUMANOID, matrix_from_quaternion(quaternions), root)


def place(pose: Pose, name: str) -> np.ndarray:
    return pose.positions[:, HUMANOID.index(name)]


def test_wrists_arrive_where_they_were_sent():
    aims = np.array([(0.05, -0.25, 0.30), (-0.12, -0.20, 0.30), (0.30, 0.25, 0.10), (0.0, 0.05, 0.25)], np.float32)
    controls = replace(neutral(4), wrist=np.stack([aims, aims], axis=1), spine=np.zeros((4, 3), np.float32))
    pose = posed(controls)
    reach = place(pose, "leftHand") - place(pose, "leftUpperArm")
    np.testing.assert_allclose(reach, aims, atol=2e-3)
    across = place(pose, "rightHand") - place(pose, "rightUpperArm")
    np.testing.assert_allclose(across * [-1, 1, 1], aims, atol=2e-3)


def test_far_targets_are_approached_without_locking_or_jumping():
    far = np.linspace(0.2, 1.0, 200, dtype=np.float32)
    wrist = np.zeros((200, 2, 3), np.float32)
    wrist[..., 2] = far[:, None]
    pose = posed(replace(neutral(200), wrist=wrist))
    length = np.linalg.norm(place(pose, "leftHand") - place(pose, "leftUpperArm"), axis=-1)
    assert length.max() < 0.51
    assert np.all(np.diff(length) > -1e-4)
    assert np.diff(length).max() < 0.006


@pytest.mark.parametrize("pitch", [0.0, 0.6])
def test_a_planted_ball_of_the_foot_stays_put_while_the_body_moves(pitch: float):
    sway = 0.05 * np.sin(np.linspace(0, 6, 60)).astype(np.float32)
    controls = neutral(60)
    controls.pelvis_position[:, 0] += sway
    controls.pelvis_position[:, 1] -= 0.1 * sway**2
    controls.pelvis_rotation[:, 0] += 3 * sway
    controls.foot_pitch[:, 0] = np.linspace(0, pitch, 60)
    toes = place(posed(controls), "leftToes")
    assert np.abs(toes - toes[0]).max() < 1e-5
    assert toes[0, 1] == pytest.approx(0.02, abs=1e-5)


def test_the_pelvis_sinks_rather_than_pulling_a_foot_along():
    controls = neutral(2)
    controls.foot_position[1, 0, 0] += 0.45
    pose = posed(controls)
    np.testing.assert_allclose(place(pose, "leftFoot")[1], controls.foot_position[1, 0], atol=1e-4)
    assert place(pose, "hips")[1, 1] < place(pose, "hips")[0, 1] - 0.03


def test_palms_turn_the_way_their_names_say():
    controls = neutral(3)
    controls.wrist[:] = (0.0, -0.22, 0.30)
    controls.palm[:] = 0
    controls.palm[1, :, 2], controls.palm[2, :, 2] = 1.3, -1.3
    normal = -posed(controls).rotations[:, HUMANOID.index("leftHand"), :, 1]  # the palm looks along -y
    assert normal[0, 0] < -0.5  # handshake: towards the middle
    assert normal[1, 1] < -0.7  # pronated: down
    assert normal[2, 1] > 0.5  # supinated: up


def test_fingers_close_towards_the_palm_and_a_pinch_brings_thumb_and_index_together():
    controls = neutral(3)
    for frame, shape in enumerate(("flat", "fist", "pinch")):
        controls.fingers[frame] = hand_shape(shape)
    pose = posed(controls)
    wrist = place(pose, "leftHand")
    reach = np.linalg.norm(place(pose, "leftMiddleDistal") - wrist, axis=-1)
    assert reach[1] < 0.75 * reach[0]

    def gap(frame: int) -> float:
        tips = []
        for finger, far in (("Thumb", 0.028), ("Index", 0.022)):
            joint = HUMANOID.index(f"left{finger}Distal")
            way = HUMANOID.offsets[joint] / np.linalg.norm(HUMANOID.offsets[joint]) * far
            tips.append(pose.positions[frame, joint] + pose.rotations[frame, joint] @ way)
        return float(np.linalg.norm(tips[0] - tips[1]))

    assert gap(2) < 0.03 < gap(0)


def test_mirrored_controls_give_the_mirrored_pose():
    table = neutral(5).packed()
    controls = Controls.unpacked(table + np.random.default_rng(1).normal(0, 0.05, table.shape))
    straight, swapped = posed(controls).positions, posed(mirrored(controls)).positions
    back = swapped[:, list(HUMANOID.config.mirror)] * np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(back, straight, atol=1e-4, rtol=0)


def test_blocks_do_not_matter():
    controls = neutral(9)
    whole, _ = solve(controls)
    parts = np.concatenate([solve(controls[:4])[0], solve(controls[4:])[0]])
    np.testing.assert_allclose(whole, parts, atol=1e-6)
