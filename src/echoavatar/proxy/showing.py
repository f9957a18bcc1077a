"""What comes back from the avatar, as events beside the voice: frames of items, idle frames, music, flushes."""

from collections.abc import Iterator

import numpy as np

from ..wire import ActionStatus, Flush, Motion, Ready, ServerMessage, Sound
from . import added
from .hearing import Hearing
from .voices import Voice

INAUDIBLE = 2  # of 32,768: what rounding leaves of speech taken from speech


class Showing:
    """Turns an avatar's messages into events, for one of its sessions."""

    def __init__(self, hearing: Hearing, ready: Ready, *, idle: bool) -> None:
        self._hearing, self._ready, self._idle = hearing, ready, idle
        self._motion: Motion | None = None

    def take(self, message: ServerMessage) -> Iterator[added.Added]:
        """The events of one message. Motion waits for the sound of the same clock, which says whose it is."""
        match message:
            case Motion():
                self._motion = message
            case Sound():
                motion, self._motion = self._motion, None
                voice = self._hearing.voices.of(message.seg)
                if motion is not None and motion.at == message.at:
                    yield from self._frames(motion, voice)
                yield from self._music(message, voice)
                if voice is not None and voice.is_over and not voice.is_told:
                    voice.is_told = True
                    if self._ready.face:
                        yield added.blendshapes_done(voice)
            case Flush():
                cut = self._hearing.voices.of(message.seg)
                for voice in self._hearing.voices:
                    voice.void(message.at)
                self._motion = None
                yield added.flush(message, cut)
            case ActionStatus():
                yield added.action_status(message)

    def _frames(self, motion: Motion, voice: Voice | None) -> Iterator[added.Added]:
        if voice is None or voice.cut is not None or motion.at not in voice.clock:
            if self._idle and not self._hearing.is_cutting:
                yield added.body(motion, None)
            return
        chunk = voice.clock.index(motion.at)
        if motion.face:
            yield added.blendshapes(motion, voice, chunk)
        yield added.body(motion, voice, chunk)

    def _music(self, message: Sound, voice: Voice | None) -> Iterator[added.Added]:
        """The voice has its own way to the client, untouched: here goes what else is to be heard."""
        sound = np.frombuffer(message.pcm, "<i2")
        if voice is not None and message.at in voice.clock:
            speech = voice.speech(voice.clock.index(message.at))[: len(sound)]
            difference = sound.astype(np.int32) - speech
            if np.abs(difference).max(initial=0) <= INAUDIBLE:
                return
            sound = np.clip(difference, -32_768, 32_767).astype(np.int16)
        if sound.any():
            yield added.music(message.at, sound)
