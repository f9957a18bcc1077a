"""What a bridge puts out: chunks of motion with their sound, and what becomes of them."""

from typing import NamedTuple

from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar.wire import ActionStatus, Flush, Motion, Ready, Sound, State

_FRAME_BYTES = 2 * SAMPLES_PER_FRAME


class AvatarChunk(NamedTuple):
    """Some frames of motion and the sound to play with them."""

    motion: Motion
    pcm: bytes  # s16le mono, 24 kHz; empty if there is nothing to hear, or if the sound was released before
    at: int  # its clock
    seg: int  # utterance that speaks here; 0: none
    is_revision: bool = False  # replaces motion released before, so it must overtake what a framework has queued

    def messages(self) -> tuple[Motion | Sound, ...]:
        """Motion and sound as a session's messages; a chunk without sound is silent."""
        if self.is_revision:
            return (self.motion,)
        pcm = self.pcm or bytes(self.motion.frames * _FRAME_BYTES)
        return self.motion, Sound(at=self.at, epoch=self.motion.epoch, seg=self.seg, pcm=pcm)


class Flushed(NamedTuple):
    """Everything released from `flush.at` on is void: it was interrupted, or is remade for a gesture."""

    flush: Flush
    is_interruption: bool


class UtteranceDone(NamedTuple):
    """An utterance was released completely; its last sample is heard at clock `at`."""

    seg: int
    at: int


Event = AvatarChunk | Flushed | UtteranceDone | Ready | State | ActionStatus


def make_chunk(motion: Motion | None, sound: Sound, *, released_to: int, cut_seg: int) -> AvatarChunk:
    """Combine motion and sound of one clock; a slow connection may have dropped the motion, never the sound.

    Sound up to clock `released_to` was released before; a chunk there is remade motion for a gesture and brings no
    sound. Utterances up to `cut_seg` were cut off, and the rest of their last chunk is silence.
    """
    if motion is None or motion.at != sound.at:
        frames = len(sound.pcm) // _FRAME_BYTES
        motion = Motion(at=sound.at, epoch=sound.epoch, frames=frames, rotations=b"", root=b"", face=b"", state="idle")
    seg = sound.seg if sound.seg > cut_seg else 0
    pcm = sound.pcm if seg or any(sound.pcm) else b""
    is_revision = sound.at < released_to
    return AvatarChunk(motion, b"" if is_revision else pcm, sound.at, seg, is_revision)
