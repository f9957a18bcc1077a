"""Pictures and sound of a session at any moment of its clock."""

import math
from collections import deque
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int16, UInt8

from echoavatar.errors import EchoAvatarError
from echoavatar.files.avatar import CHARACTERS, Character, load_character
from echoavatar.files.avatar.avatar_renderer import AvatarRenderer, Shot
from echoavatar.files.avatar.framing import aimed, followed
from echoavatar.files.avatar.render import Paint
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.server.sinks.player import PoseTrack
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.blobs import unpack_pose
from echoavatar.wire.messages import Flush, Motion, Rig, ServerMessage, Sound

FOLLOW_S = 0.5  # the camera reaches 63 % of a new place in this time
KEPT_S = 2.0  # how long sound is kept behind the newest reading
MOST_MOTION = 1_000  # most messages that wait to be drawn


class SoundTrack:
    """Samples on the session's clock. The writer bounds its length; samples far behind the reader are dropped."""

    def __init__(self) -> None:
        self._blocks: deque[tuple[int, Int16[np.ndarray, " s"]]] = deque()

    @property
    def end(self) -> int:
        """The clock up to which there is sound; 0 if there is none."""
        return self._blocks[-1][0] + len(self._blocks[-1][1]) if self._blocks else 0

    def put(self, at: int, samples: Int16[np.ndarray, " s"]) -> None:
        """Add samples from `at` on; they replace existing samples from that moment on."""
        self.cut(at)
        self._blocks.append((at, samples))

    def cut(self, at: int) -> None:
        """Remove all sound from `at` on."""
        self._blocks = deque((start, samples[: at - start]) for start, samples in self._blocks if start < at)

    def read(self, at: int, count: int) -> Int16[np.ndarray, " s"]:
        """The samples `at` to `at + count`; where there are none, silence."""
        while self._blocks and self._blocks[0][0] + len(self._blocks[0][1]) < at - KEPT_S * SAMPLE_RATE_HZ:
            self._blocks.popleft()
        read = np.zeros(count, np.int16)
        for start, samples in self._blocks:
            low, high = max(at, start), min(at + count, start + len(samples))
            if low < high:
                read[low - at : high - at] = samples[low - start : high - start]
        return read


class VideoSource:
    """Takes a session's messages; gives its sound, and the picture of its pose.

    `take` and `sound` belong to one thread (the event loop), `picture` to another: a picture takes tens of
    milliseconds.
    """

    def __init__(self, rig: Rig, shot: Shot, *, character: str = "") -> None:
        """`rig` is that of the motion messages; `character` is a shipped one (empty: the first).

        Raises:
            EchoAvatarError: there is no such character or background, or the rig is not the humanoid of 52 bones.
        """
        if tuple(rig.names) != HUMANOID.names:
            raise EchoAvatarError(
                f"video shows the humanoid of {HUMANOID.joints} bones; this model moves a rig of {len(rig.names)}"
            )
        painted, paint = _painted(character)
        self._character, self._renderer = painted, AvatarRenderer(painted, shot, paint)
        self._sound, self._poses = SoundTrack(), PoseTrack()
        self._waiting = deque[Motion | Flush](maxlen=MOST_MOTION)
        self._followed: tuple[float, Float[np.ndarray, " 3"]] | None = None  # clock and aim of the camera

    @property
    def end(self) -> int:
        """The clock up to which the session has arrived."""
        return self._sound.end

    def take(self, message: ServerMessage) -> None:
        """Take one message of the session; other kinds than motion, sound and flushes are ignored."""
        if isinstance(message, Motion | Flush):
            self._waiting.append(message)
        if isinstance(message, Sound):
            self._sound.put(message.at, np.frombuffer(message.pcm, "<i2").astype(np.int16, copy=False))
        elif isinstance(message, Flush):
            self._sound.cut(message.at)

    def mute(self, at: int) -> None:
        """Silence from clock `at` on, as far as sound has arrived; the motion stays."""
        self._sound.put(at, np.zeros(max(0, self.end - at), np.int16))

    def sound(self, at: int, count: int) -> Int16[np.ndarray, " s"]:
        """The samples from clock `at` on, 24 kHz; silence where none arrived."""
        return self._sound.read(at, count)

    def picture(self, at: float) -> UInt8[np.ndarray, "h w c"]:
        """The picture at clock `at`: of the nearest pose that has arrived; the rest pose before any has."""
        self._hear()
        pose = self._poses.read(at)
        if pose is None:
            rotations = np.tile(np.array([1, 0, 0, 0], np.float32), (HUMANOID.joints, 1))
            root, face = HUMANOID.rest_positions[0], None
        else:
            rotations, root, face = pose.rotations.astype(np.float32), pose.root, pose.face
        turned, positions = forward_kinematics(
            HUMANOID, matrix_from_quaternion(rotations), np.asarray(root, np.float32)
        )
        view = self._renderer.shot.view
        joint, size = followed(view, self._character)
        camera = aimed(view, self._follow(at, positions[joint]), size)
        return self._renderer.draw(turned, positions, face, camera)

    def _hear(self) -> None:
        while self._waiting:
            message = self._waiting.popleft()
            if isinstance(message, Flush):
                self._poses.cut(message.at)
            else:
                self._poses.put(message.at, unpack_pose(message, joints=HUMANOID.joints))

    def _follow(self, at: float, place: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        """Where the camera looks: it follows the body slowly, so that a step does not shake the picture."""
        if self._followed is None:
            self._followed = at, place
        before, looked = self._followed
        share = 1 - math.exp(-max(0.0, at - before) / (FOLLOW_S * SAMPLE_RATE_HZ))
        self._followed = at, looked + share * (place - looked)
        return self._followed[1]


def prepare(shot: Shot, character: str = "") -> None:
    """Read a character and draw it once, so that the first viewer does not wait for that; raises as `VideoSource`."""
    config = HUMANOID.config
    rig = Rig(names=config.names, parents=config.parents, rest=config.offsets)
    VideoSource(rig, shot, character=character).picture(0)


@lru_cache(len(CHARACTERS))
def _painted(name: str) -> tuple[Character, Paint]:
    character = load_character(name or None)
    return character, Paint.of(character)
