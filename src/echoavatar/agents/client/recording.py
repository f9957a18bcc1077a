"""Collect the messages of a session into one motion and one sound track."""

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import whole_file
from echoavatar.wire.blobs import Pose, unpack_audio, unpack_pose
from echoavatar.wire.messages import AudioFormat, Flush, Motion, Ready, ServerMessage, Sound, State


@dataclass(frozen=True)
class Recording:
    """Frames at 30 fps and the sound that goes with them."""

    names: tuple[str, ...]
    face_names: tuple[str, ...]
    rotations: Float[np.ndarray, "t j 4"]  # quaternions wxyz, parent-relative
    root: Float[np.ndarray, "t 3"]  # metres
    face: Float[np.ndarray, "t c"]  # 0..1; no columns without a face
    audio: Float[np.ndarray, " s"]  # 24 kHz mono

    @property
    def seconds(self) -> float:
        """The length in seconds."""
        return len(self.root) / FRAME_RATE_HZ

    def save(self, path: Path) -> None:
        """Write everything, with the two rates, to an npz file, whole or not at all.

        Raises:
            MotionError: the file cannot be written.
        """
        with whole_file(path, error=MotionError) as partial, partial.open("wb") as file:
            np.savez_compressed(
                file,
                names=np.array(self.names),
                face_names=np.array(self.face_names),
                rotations=self.rotations,
                root=self.root,
                face=self.face,
                audio=self.audio,
                frame_rate=FRAME_RATE_HZ,
                sample_rate=SAMPLE_RATE_HZ,
            )


class Recorder:
    """Collects the messages of a session; give it every message, in order."""

    def __init__(self, ready: Ready) -> None:
        self.end = 0  # clock up to which there is motion
        self._ready = ready
        self._offset = 0  # added to the clock of a session that replaced a lost one
        self._frames: dict[int, Pose] = {}  # by clock
        self._sound: dict[int, Float[np.ndarray, " s"]] = {}
        self._began: dict[int, int] = {}
        self._finished: dict[int, int] = {}

    def take(self, message: ServerMessage) -> None:
        """Take one message; messages that carry neither motion nor sound are ignored."""
        if isinstance(message, Ready):
            self._offset = 0 if message.resumed else self.end - message.at
        elif isinstance(message, Motion | Sound | Flush | State):
            self._place(msgspec.structs.replace(message, at=message.at + self._offset))

    def _place(self, message: Motion | Sound | Flush | State) -> None:
        match message:
            case Motion():
                pose = unpack_pose(message, joints=len(self._ready.rig.names), curves=len(self._ready.face))
                for k in range(message.frames):
                    face = None if pose.face is None else pose.face[k : k + 1]
                    frame = Pose(pose.rotations[k : k + 1], pose.root[k : k + 1], face)
                    self._frames[message.at + k * SAMPLES_PER_FRAME] = frame
                self.end = message.at + message.frames * SAMPLES_PER_FRAME
            case Sound():
                self._sound[message.at] = unpack_audio(message.pcm, AudioFormat())
                if message.seg:
                    self._began.setdefault(message.seg, message.at)
            case Flush():
                self._frames = {at: frame for at, frame in self._frames.items() if at < message.at}
                self._sound = {at: part[: message.at - at] for at, part in self._sound.items() if at < message.at}
                self.end = min(self.end, message.at)
            case State(finished=seg, at=at) if seg:
                self._finished.setdefault(seg, at)

    def has(self, seg: int) -> bool:
        """Whether the utterance has arrived completely."""
        return any(known >= seg and self.end >= at for known, at in self._finished.items())

    def recording(self, seg: int | None = None) -> Recording:
        """Everything so far, or one utterance.

        Raises:
            MotionError: no motion has arrived.
        """
        start, end = 0, self.end
        if seg is not None:  # from its first chunk to its last sample
            start, end = self._began.get(seg, end), self._finished.get(seg, end)
        at = [at for at in sorted(self._frames) if start <= at < end]
        if not at:
            raise MotionError("the server has sent no motion")
        poses = [self._frames[k] for k in at]
        audio = np.zeros(len(at) * SAMPLES_PER_FRAME, np.float32)
        for k, part in self._sound.items():
            first, last = max(k, at[0]), min(k + len(part), at[0] + len(audio))
            if first < last:
                audio[first - at[0] : last - at[0]] = part[first - k : last - k]
        faces = [pose.face if pose.face is not None else np.zeros((1, 0), np.float32) for pose in poses]
        return Recording(
            names=self._ready.rig.names,
            face_names=self._ready.face,
            rotations=np.concatenate([pose.rotations for pose in poses]),
            root=np.concatenate([pose.root for pose in poses]),
            face=np.concatenate(faces),
            audio=audio,
        )
