"""VMC packets, read by python-osc; axes, thumbs and expression names are the traps."""

import numpy as np
import pytest
from tests.server.sinks.receiving import RIG, random_frame, shown

from echoavatar.motion.arkit import to_vrm
from echoavatar.server.sinks.vmc import VmcEncoder, expression_names, to_unity, unity_bone

osc_bundle = pytest.importorskip("pythonosc.osc_bundle")
HUMAN_BODY_BONES = [
    "Hips", "Spine", "Chest", "UpperChest", "Neck", "Head", "LeftShoulder", "LeftUpperArm", "LeftLowerArm",
    "LeftHand", "LeftThumbProximal", "LeftThumbIntermediate", "LeftThumbDistal", "LeftIndexProximal",
    "LeftLittleIntermediate", "RightUpperLeg", "RightLowerLeg", "RightFoot", "RightToes",
]  # fmt: skip


def read(packets):  # type: ignore[no-untyped-def]
    return [message for packet in packets for message in osc_bundle.OscBundle(bytes(packet))]


def test_a_frame_comes_through_whole() -> None:
    frame = random_frame()
    encoder = VmcEncoder(RIG)
    messages = read(encoder(shown(encoder, frame)))
    assert [m.address.rpartition("/")[2] for m in messages[:3]] == ["OK", "T", "Pos"]
    assert messages[1].params == [pytest.approx(frame.seconds)]
    assert messages[2].params == ["root", 0, 0, 0, 0, 0, 0, 1]
    bones = {m.params[0]: m.params[1:] for m in messages if m.address == "/VMC/Ext/Bone/Pos"}
    assert len(bones) == 52
    assert set(HUMAN_BODY_BONES) <= set(bones)
    w, x, y, z = frame.rotations[RIG.names.index("leftHand")]
    _, up, ahead = RIG.rest[RIG.names.index("leftHand")]
    aside = RIG.rest[RIG.names.index("leftHand")][0]
    np.testing.assert_allclose(bones["LeftHand"], [-aside, up, ahead, x, -y, -z, w], atol=1e-6)
    np.testing.assert_allclose(bones["Hips"][:3], frame.root * [-1, 1, 1], atol=1e-6)
    blends = {m.params[0]: m.params[1] for m in messages if m.address == "/VMC/Ext/Blend/Val"}
    np.testing.assert_allclose(list(blends.values()), to_vrm(frame.face[None])[0], atol=1e-6)
    assert list(blends)[:5] == ["A", "I", "U", "E", "O"]
    assert messages[-1].address == "/VMC/Ext/Blend/Apply"


def test_unitys_axes_mirror_rotations_correctly() -> None:
    """A rotation of +90 degrees about our Y points ahead to our left; in Unity, left is -X."""
    half = np.sqrt(0.5)
    ((x, y, z, qx, qy, qz, qw),) = to_unity(np.array([[half, 0, half, 0]]), np.array([[1.0, 2.0, 3.0]]))
    assert (x, y, z) == (-1, 2, 3)
    ahead = np.array(
        [0.0, 0.0, 1.0]
    )  # the formula for rotating a vector is the same in both; only the handedness differs
    axis = np.array([qx, qy, qz])
    turned = ahead + 2 * np.cross(axis, np.cross(axis, ahead) + qw * ahead)
    np.testing.assert_allclose(turned, [-1, 0, 0], atol=1e-12)


def test_thumbs_are_named_one_bone_further_out() -> None:
    assert [unity_bone(f"leftThumb{part}") for part in ("Metacarpal", "Proximal", "Distal")] == [
        "LeftThumbProximal",
        "LeftThumbIntermediate",
        "LeftThumbDistal",
    ]
    assert unity_bone("rightIndexProximal") == "RightIndexProximal"


@pytest.mark.parametrize(
    ("names", "first", "count"),
    [("vrm0", "A", 12), ("vrm1", "aa", 12), ("arkit", "eyeBlinkLeft", 52), ("perfect", "EyeBlinkLeft", 52)],
)
def test_expressions_have_the_requested_names(names, first, count) -> None:  # type: ignore[no-untyped-def]
    assert expression_names(names)[0] == first
    frame, encoder = random_frame(), VmcEncoder(RIG, names)
    blends = [m for m in read(encoder(shown(encoder, frame))) if m.address == "/VMC/Ext/Blend/Val"]
    assert len(blends) == count
    if count == 52:
        np.testing.assert_allclose([m.params[1] for m in blends], frame.face, atol=1e-6)


def test_without_a_face_the_expressions_rest() -> None:
    frame = random_frame(has_face=False)
    assert not any(m.params[1] for m in read(VmcEncoder(RIG)(frame)) if m.address == "/VMC/Ext/Blend/Val")
