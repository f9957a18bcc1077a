"""Turn the avatar's messages into events beside the voice: frames of items, idle frames, music, flushes."""

from collections.abc import Iterator

import numpy as np

from echoavatar.wire import ActionStatus, Flush, Motion, Ready, ServerMessage, Sound

from . import avatar_events
from .conversation import Conversation
from .speech_items import SpeechItem

INAUDIBLE = 2  # of 32,768: the rounding error left when speech is subtracted from itself


class EventWriter:
    """Turns messages of one avatar session into events."""

    def __init__(self, conversation: Conversation, ready: Ready, *, idle: bool) -> None:
        self._conversation, self._ready, self._idle = conversation, ready, idle
        self._motion: Motion | None = None

    def events_for(self, message: ServerMessage) -> Iterator[avatar_events.AvatarEvent]:
        """The events for one message. Motion waits for the sound with the same clock, which names the utterance."""
        match message:
            case Motion():
                self._motion = message
            case Sound():
                motion, self._motion = self._motion, None
                item = self._conversation.items.of(message.seg)
                if motion is not None and motion.at == message.at:
                    yield from self._frames(motion, item)
                yield from self._music(message, item)
                if item is not None and item.is_over and not item.is_announced:
                    item.is_announced = True
                    if self._ready.face:
                        yield avatar_events.blendshapes_done(item)
            case Flush():
                cut = self._conversation.items.of(message.seg)
                for item in self._conversation.items:
                    item.void(message.at)
                self._motion = None
                yield avatar_events.flush(message, cut)
            case ActionStatus():
                yield avatar_events.action_status(message)

    def _frames(self, motion: Motion, item: SpeechItem | None) -> Iterator[avatar_events.AvatarEvent]:
        if item is None or item.cut is not None or motion.at not in item.clock:
            if self._idle and not self._conversation.is_cutting:
                yield avatar_events.body(motion, None)
            return
        chunk = item.clock.index(motion.at)
        if motion.face:
            yield avatar_events.blendshapes(motion, item, chunk)
        yield avatar_events.body(motion, item, chunk)

    def _music(self, message: Sound, item: SpeechItem | None) -> Iterator[avatar_events.AvatarEvent]:
        """The client gets the voice from upstream, so only what sounds beside it (music) is sent here."""
        samples = np.frombuffer(message.pcm, "<i2")
        if item is not None and message.at in item.clock:
            speech = item.speech(item.clock.index(message.at))[: len(samples)]
            difference = samples.astype(np.int32) - speech
            if np.abs(difference).max(initial=0) <= INAUDIBLE:
                return
            samples = np.clip(difference, -32_768, 32_767).astype(np.int16)
        if samples.any():
            yield avatar_events.music(message.at, samples)
