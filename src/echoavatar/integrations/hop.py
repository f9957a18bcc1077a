"""What leaves a stage: hops of motion with their sound, and what becomes of them."""

from typing import NamedTuple

from ..timing import SAMPLES_PER_FRAME
from ..wire import ActionStatus, Flush, Motion, Ready, Sound, State

_FRAME_BYTES = 2 * SAMPLES_PER_FRAME


class Hop(NamedTuple):
    """Some frames of motion and the sound that belongs under them; the motion must be shown with the sound."""

    motion: Motion
    pcm: bytes  # s16le mono, 24 kHz; empty where nothing is to be heard, or where it left before with other motion
    at: int  # clock
    seg: int  # utterance that speaks here; 0 is none
    is_again: bool = False  # its sound left before: the motion must overtake what a framework has queued


class Cut(NamedTuple):
    """What left before from `flush.at` on is void: it was interrupted, or is made again for a gesture."""

    flush: Flush
    is_interruption: bool


class Said(NamedTuple):
    """All of an utterance has left; its last sample is heard at clock `at`."""

    seg: int
    at: int


Event = Hop | Cut | Said | Ready | State | ActionStatus


def make_hop(motion: Motion | None, sound: Sound, *, left: int, cut_seg: int) -> Hop:
    """Two halves of a hop put together; a slow line may have lost motion, never sound.

    `left` is the clock up to which sound left before: what lies there was made again for a gesture. What is left of a
    chunk of utterances up to `cut_seg`, which were cut off, is silence.
    """
    if motion is None or motion.at != sound.at:
        frames = len(sound.pcm) // _FRAME_BYTES
        motion = Motion(
            at=sound.at, epoch=sound.epoch, frames=frames, rotations=b"", root=b"", face=b"", state="idle"
        )
    seg = sound.seg if sound.seg > cut_seg else 0
    pcm = sound.pcm if seg or any(sound.pcm) else b""
    is_again = sound.at < left
    return Hop(motion, b"" if is_again else pcm, sound.at, seg, is_again)
