"""Messages: their length and shapes, and that no frame or sample is lost between blocks."""

import json

import numpy as np

from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar_lab.reference.release_rig import AXES
from echoavatar_lab.unity.message import HEADER, Messages

EYE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def chunks(count: int) -> list[tuple[MotionChunk, np.ndarray]]:
    """Chunks of eight frames; the root moves one centimetre per frame, and the sound counts its samples."""
    made = []
    for index in range(count):
        turns = np.tile(np.float32([1, 0, 0, 0]), (8, 88, 1))
        root = np.zeros((8, 3), np.float32)
        root[:, 0] = 0.01 * (np.arange(8) + 8 * index)
        sound = np.arange(6400, dtype=np.float32) + 6400 * index
        made.append((MotionChunk(turns, root, np.zeros((8, 52), np.float32)), sound))
    return made


def test_three_chunks_are_two_messages() -> None:
    messages = Messages(RigConfig(axes=AXES, metres_per_unit=0.01, up=2, unity=(EYE,) * 88))
    sent = [list(messages.push(*chunk)) for chunk in chunks(6)]
    assert [len(own) for own in sent] == [0, 1, 1, 0, 1, 1]
    bodies = []
    for message in (m for own in sent for m in own):
        (size,) = HEADER.unpack(message[:4])
        assert size == len(message) - 4
        bodies.append(json.loads(message[4:]))
    shapes = {name: np.shape(bodies[0][name]) for name in bodies[0]}
    assert shapes == {"pose": (24, 88, 4), "trans": (24, 3), "blendshape": (24, 47), "audio": (9600,)}
    audio = np.concatenate([body["audio"] for body in bodies])
    assert np.array_equal(audio, np.arange(4 * 9600))
    steps = np.concatenate([np.array(body["trans"])[::2, 0] for body in bodies])
    np.testing.assert_allclose(steps, np.arange(48), atol=1e-4)
    assert np.array(bodies[0]["pose"])[0, 0].tolist() == [0, 0, 0, 1]


def test_a_bundle_without_a_face_sends_a_face_at_rest() -> None:
    messages = Messages(RigConfig(axes=AXES, metres_per_unit=0.01, up=2, unity=(EYE,) * 88))
    (motion, audio), (more, sound) = chunks(2)
    list(messages.push(motion._replace(face=None), audio))
    (message,) = messages.push(more._replace(face=None), sound)
    assert not np.any(json.loads(message[4:])["blendshape"])
