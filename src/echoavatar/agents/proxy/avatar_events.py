"""The events that the proxy adds. The face uses the event names of Azure's Voice Live, all others `echoavatar.`.

`docs/integrations/openai_realtime.md` lists them. Binary fields are those of protocol `echoavatar.v1`, in base64.
"""

import base64
import itertools
import json
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Int16

from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire import ActionStatus, Flush, Motion, Ready

from .speech_items import SpeechItem

AvatarEvent = dict[str, Any]
_NUMBERS = itertools.count(1)


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


def blendshapes_done(item: SpeechItem) -> AvatarEvent:
    """All face frames of an item were sent."""
    return {"type": "response.animation_blendshapes.done", **_address(item)}


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


def music(at: int, pcm: Int16[np.ndarray, " s"]) -> AvatarEvent:
    """Music to play beside the voice: 24 kHz, s16le, mono."""
    return {"type": "echoavatar.music.delta", "at": at, "delta": _text(pcm.astype("<i2").tobytes())}


def action_status(message: ActionStatus) -> AvatarEvent:
    """The status of an action or of music."""
    return {
        "type": "echoavatar.action_status",
        "id": message.id,
        "name": message.name,
        "status": message.status,
        "at": message.at,
        "reason": message.reason,
    }


def _address(item: SpeechItem) -> AvatarEvent:
    return {
        "response_id": item.response_id,
        "item_id": item.item_id,
        "output_index": item.output_index,
        "content_index": item.content_index,
    }


def _text(blob: bytes) -> str:
    return base64.b64encode(blob).decode()
