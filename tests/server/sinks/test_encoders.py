"""Datagrams, read by decoders that share no code with the encoders; axes, thumbs and expression names are the traps."""

import json
import struct

import numpy as np
import pytest
from tests.server.sinks.receiving import RIG, random_frame, shown

from echoavatar.motion.arkit import ARKIT_NAMES, to_vrm
from echoavatar.server.sinks.encoders import (
    Bundles,
    JsonEncoder,
    LiveLinkEncoder,
    Message,
    VmcEncoder,
    expression_names,
    head_angles,
    padded,
    to_unity,
    unity_bone,
)

# Unreal's EARFaceBlendShape, in the order of its engine and of the packet
UNREAL = [
    "EyeBlinkLeft", "EyeLookDownLeft", "EyeLookInLeft", "EyeLookOutLeft", "EyeLookUpLeft", "EyeSquintLeft",
    "EyeWideLeft", "EyeBlinkRight", "EyeLookDownRight", "EyeLookInRight", "EyeLookOutRight",
    "EyeLookUpRight", "EyeSquintRight", "EyeWideRight", "JawForward", "JawLeft", "JawRight", "JawOpen",
    "MouthClose", "MouthFunnel", "MouthPucker", "MouthLeft", "MouthRight", "MouthSmileLeft",
    "MouthSmileRight", "MouthFrownLeft", "MouthFrownRight", "MouthDimpleLeft", "MouthDimpleRight",
    "MouthStretchLeft", "MouthStretchRight", "MouthRollLower", "MouthRollUpper", "MouthShrugLower",
    "MouthShrugUpper", "MouthPressLeft", "MouthPressRight", "MouthLowerDownLeft", "MouthLowerDownRight",
    "MouthUpperUpLeft", "MouthUpperUpRight", "BrowDownLeft", "BrowDownRight", "BrowInnerUp",
    "BrowOuterUpLeft", "BrowOuterUpRight", "CheekPuff", "CheekSquintLeft", "CheekSquintRight",
    "NoseSneerLeft", "NoseSneerRight", "TongueOut", "HeadYaw", "HeadPitch", "HeadRoll", "LeftEyeYaw",
    "LeftEyePitch", "LeftEyeRoll", "RightEyeYaw", "RightEyePitch", "RightEyeRoll",
]  # fmt: skip
MESSAGES = [
    Message("/one", "a name", 3),
    Message("/two", 7, 0),
    Message("/three", None, 1),
    *[Message("/many/of/them", f"number {k}", 7) for k in range(60)],
]
HUMAN_BODY_BONES = [
    "Hips", "Spine", "Chest", "UpperChest", "Neck", "Head", "LeftShoulder", "LeftUpperArm", "LeftLowerArm",
    "LeftHand", "LeftThumbProximal", "LeftThumbIntermediate", "LeftThumbDistal", "LeftIndexProximal",
    "LeftLittleIntermediate", "RightUpperLeg", "RightLowerLeg", "RightFoot", "RightToes",
]  # fmt: skip


def test_the_rig_comes_first_and_every_second_and_poses_fit_it() -> None:
    encoder, frame = JsonEncoder(RIG), random_frame()
    rig, pose = (json.loads(packet) for packet in encoder(frame._replace(seconds=0.0)))
    assert (rig["type"], pose["type"]) == ("rig", "pose")
    assert len(rig["names"]) == len(rig["parents"]) == len(rig["rest"]) == len(pose["rotations"])
    assert len(rig["face"]) == len(pose["face"])
    wxyz = np.roll(pose["rotations"], 1, axis=-1)
    np.testing.assert_allclose(wxyz, frame.rotations, atol=1e-5)
    np.testing.assert_allclose(pose["root"], frame.root, atol=1e-5)
    assert pose["clock"] == 0.2
    counts = [len(list(encoder(frame._replace(seconds=t)))) for t in (0.5, 0.99, 1.0, 1.5)]
    assert counts == [1, 1, 2, 1]


def test_a_datagram_holds_a_frame() -> None:
    assert max(len(packet) for packet in JsonEncoder(RIG)(random_frame())) < 8_000


def test_no_face_is_null() -> None:
    *_, pose = JsonEncoder(RIG)(random_frame(has_face=False))
    assert json.loads(pose)["face"] is None


def decoded(packet: bytes) -> dict:  # type: ignore[type-arg]
    """Decode a packet byte by byte, as the app's receivers do."""
    version = int.from_bytes(packet[:4], "little")
    device = packet[4:41].decode()
    length = int.from_bytes(packet[41:45], "big")
    name, rest = packet[45 : 45 + length].decode(), packet[45 + length :]
    frame, part, rate, denominator, count = struct.unpack(">ifiib", rest[:17])
    values = np.frombuffer(rest[17:], ">f4")
    assert len(values) == count == 61
    return {
        "version": version,
        "device": device,
        "name": name,
        "frame": frame + part,
        "rate": rate / denominator,
        "shapes": dict(zip(UNREAL, values.tolist(), strict=True)),
    }


def test_a_face_comes_through_under_unreals_names() -> None:
    frame = random_frame()
    encoder = LiveLinkEncoder(RIG, subject="Ada", rate=60)
    (packet,) = encoder(shown(encoder, frame))
    read = decoded(packet)
    assert len(packet) == 45 + 3 + 17 + 61 * 4
    assert (read["version"], read["name"], read["rate"]) == (6, "Ada", 60)
    assert read["device"].startswith("$")
    assert read["frame"] == pytest.approx(frame.seconds * 60, abs=1e-3)
    for name, weight in zip(ARKIT_NAMES, frame.face, strict=True):
        assert read["shapes"][name[:1].upper() + name[1:]] == pytest.approx(weight, abs=1e-6), name


def test_eyes_look_where_the_curves_say() -> None:
    face = np.zeros(52, np.float32)
    face[ARKIT_NAMES.index("eyeLookOutLeft")] = face[ARKIT_NAMES.index("eyeLookInRight")] = 1  # to its left
    encoder = LiveLinkEncoder(RIG)
    (packet,) = encoder(shown(encoder, random_frame()._replace(face=face)))
    shapes = decoded(packet)["shapes"]
    assert shapes["LeftEyeYaw"] == pytest.approx(shapes["RightEyeYaw"])
    assert shapes["LeftEyeYaw"] < -0.3


@pytest.mark.parametrize(
    ("axis", "angle"), [((0, 1, 0), (-0.4, 0, 0)), ((1, 0, 0), (0, 0.4, 0)), ((0, 0, 1), (0, 0, 0.4))]
)
def test_the_heads_angles_are_those_of_neck_and_head_together(axis, angle) -> None:  # type: ignore[no-untyped-def]
    """Turning to the left is negative, nodding positive, tilting to the right positive."""
    half = np.array([np.cos(0.1), *(np.sin(0.1) * np.array(axis))])
    np.testing.assert_allclose(head_angles(np.stack([half, half])), angle, atol=1e-6)


def test_a_bundle_without_a_face_sends_a_face_at_rest() -> None:
    (packet,) = LiveLinkEncoder(RIG)(random_frame(has_face=False))
    assert not any(list(decoded(packet)["shapes"].values())[:52])


def read(packets):  # type: ignore[no-untyped-def]
    """What python-osc, which shares no code with us, reads."""
    osc_bundle = pytest.importorskip("pythonosc.osc_bundle")
    return [message for packet in packets for message in osc_bundle.OscBundle(bytes(packet))]


def test_an_independent_reader_finds_every_message_with_its_numbers() -> None:
    values = np.random.default_rng(0).normal(size=sum(message.floats for message in MESSAGES))
    found = read(Bundles(MESSAGES).fill(values))
    assert [message.address for message in found] == [message.address for message in MESSAGES]
    floats = [x for message in found for x in message.params if isinstance(x, float)]
    np.testing.assert_allclose(floats, values, rtol=1e-6)
    firsts = [message.params[0] for message in found if message.params and not isinstance(message.params[0], float)]
    assert firsts == [message.first for message in MESSAGES if message.first is not None]


def test_packets_fit_an_ethernet_frame_and_are_filled_again() -> None:
    bundles = Bundles(MESSAGES)
    sizes = list(map(len, bundles.packets))
    assert max(sizes) <= 1_472  # of 1,500 bytes, beside the headers of IP and UDP
    assert len(sizes) == -(-sum(sizes) // 1_400)
    count = sum(message.floats for message in MESSAGES)
    bundles.fill(np.ones(count))
    floats = [x for m in read(bundles.fill(np.zeros(count))) for x in m.params if isinstance(x, float)]
    assert not any(floats)


@pytest.mark.parametrize(("text", "length"), [("", 4), ("abc", 4), ("abcd", 8)])
def test_strings_end_with_a_zero_on_a_border_of_four(text: str, length: int) -> None:
    assert padded(text) == text.encode() + b"\0" * (length - len(text))


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
