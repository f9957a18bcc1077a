"""Live Link Face packets, read by a decoder of the published layout that shares no code with the encoder."""

import struct

import numpy as np
import pytest
from tests.server.sinks.receiving import RIG, random_frame, shown

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.server.sinks.live_link import LiveLinkEncoder, head_angles

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
