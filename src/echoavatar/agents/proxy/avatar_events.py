"""The events that the proxy adds. The face uses the event names of Azure's Voice Live, all others `echoavatar.`.

`EventWriter` turns the avatar's messages into them: frames of items, idle frames, music, flushes.
`docs/integrations/openai_realtime.md` lists them. Binary fields are those of protocol `echoavatar.v1`, in base64.
"""

import base64
import itertools
import json
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np

from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.messages import ActionStatus, Flush, Motion, Ready, ServerMessage, Sound

from .conversation import Conversation
from .speech_items import SpeechItem

AvatarEvent = dict[str, Any]
_NUMBERS = itertools.count(1)
INAUDIBLE = 2  # of 32,768: the rounding error left when speech is subtracted from itself


def encode(event: AvatarEvent) -> str:
    """Serialise one event."""
    return json.dumps({"type": event["type"], "event_id": f"echoavatar_{next(_NUMBERS)}"} | event)


def session_created(ready: Ready) -> AvatarEvent:
    """Everything about the avatar that stays constant; sent once."""
    return {
        "type": "echoavatar.session.created",
        "session": ready.session,
        "server": ready.server,
        "sample_rate": SAMPLE_RATE_HZ,
        "frame_rate": FRAME_RATE_HZ,
        "frame_samples": SAMPLES_PER_FRAME,
        "rig": msgspec.to_builtins(ready.rig),
        "blendshapes": list(ready.face),
        "actions": list(ready.actions),
        "tracks": list(ready.tracks),
    }


def session_lost(reason: str) -> AvatarEvent:
    """The avatar failed and the voice goes on; another `echoavatar.session.created` may follow."""
    return {"type": "echoavatar.session.lost", "reason": reason}


def blendshapes(motion: Motion, item: SpeechItem, chunk: int) -> AvatarEvent:
    """The face for part of an item, in the form of Azure's Voice Live."""
    rows = np.frombuffer(motion.face, "u1").reshape(motion.frames, -1)
    return {
        "type": "response.animation_blendshapes.delta",
        **_address(item),
        "frames": [[round(value / 255, 3) for value in row] for row in rows.tolist()],
        "frame_index": item.frame(chunk),
    }


def body(motion: Motion, item: SpeechItem | None, chunk: int = 0) -> AvatarEvent:
    """The body. Between utterances it has no item to refer to, and carries the face as well."""
    event = {
        "type": "echoavatar.animation_body.delta",
        **(_address(item) if item is not None else {"response_id": None, "item_id": None}),
        "frame_index": None if item is None else item.frame(chunk),
        "frames": motion.frames,
        "at": motion.at,
        "rotations": _text(motion.rotations),
        "root": _text(motion.root),
        "state": motion.state,
    }
    return event if item is not None else event | {"face": _text(motion.face)}


def flush(message: Flush, item: SpeechItem | None) -> AvatarEvent:
    """All frames from clock `at` on are void; names the item that was cut off, if there was one."""
    event: AvatarEvent = {"type": "echoavatar.flush", "at": message.at, "epoch": message.epoch}
    if item is not None:
        event |= {"item_id": item.item_id, "content_index": item.content_index}
    return event


def _address(item: SpeechItem) -> AvatarEvent:
    return {key: getattr(item, key) for key in ("response_id", "item_id", "output_index", "content_index")}


def _text(blob: bytes) -> str:
    return base64.b64encode(blob).decode()


class EventWriter:
    """Turns messages of one avatar session into events."""

    def __init__(self, conversation: Conversation, ready: Ready, *, idle: bool) -> None:
        self._conversation, self._ready, self._idle = conversation, ready, idle
        self._motion: Motion | None = None

    def events_for(self, message: ServerMessage) -> Iterator[AvatarEvent]:
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
                        yield {"type": "response.animation_blendshapes.done", **_address(item)}
            case Flush():
                cut = self._conversation.items.of(message.seg)
                for item in self._conversation.items:
                    item.void(message.at)
                self._motion = None
                yield flush(message, cut)
            case ActionStatus():
                told = {key: getattr(message, key) for key in ("id", "name", "status", "at", "reason")}
                yield {"type": "echoavatar.action_status", **told}

    def _frames(self, motion: Motion, item: SpeechItem | None) -> Iterator[AvatarEvent]:
        if item is None or item.cut is not None or motion.at not in item.clock:
            if self._idle and not self._conversation.is_cutting:
                yield body(motion, None)
            return
        chunk = item.clock.index(motion.at)
        if motion.face:
            yield blendshapes(motion, item, chunk)
        yield body(motion, item, chunk)

    def _music(self, message: Sound, item: SpeechItem | None) -> Iterator[AvatarEvent]:
        """The client gets the voice from upstream, so only what sounds beside it (music) is sent here."""
        samples = np.frombuffer(message.pcm, "<i2")
        if item is not None and message.at in item.clock:
            speech = item.speech(item.clock.index(message.at))[: len(samples)]
            difference = samples.astype(np.int32) - speech
            if np.abs(difference).max(initial=0) <= INAUDIBLE:
                return
            samples = np.clip(difference, -32_768, 32_767).astype(np.int16)
        if samples.any():
            yield {"type": "echoavatar.music.delta", "at": message.at, "delta": _text(samples.astype("<i2").tobytes())}
