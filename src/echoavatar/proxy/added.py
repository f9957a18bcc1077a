"""The events that the proxy adds: the face under the names of Azure's Voice Live, all else under `echoavatar.`.

`docs/integrations/openai_realtime.md` lists them. Blobs are those of protocol `echoavatar.v1`, in base64.
"""

import base64
import itertools
import json
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Int16

from ..timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from ..wire import ActionStatus, Flush, Motion, Ready
from .voices import Voice

Added = dict[str, Any]
_NUMBERS = itertools.count(1)


def encode(event: Added) -> str:
    """One event to text."""
    return json.dumps({"type": event["type"], "event_id": f"echoavatar_{next(_NUMBERS)}"} | event)


def session_created(ready: Ready) -> Added:
    """Everything about the avatar that does not change, once."""
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


def session_lost(reason: str) -> Added:
    """The avatar is gone, the voice goes on; another `echoavatar.session.created` may follow."""
    return {"type": "echoavatar.session.lost", "reason": reason}


def blendshapes(motion: Motion, voice: Voice, chunk: int) -> Added:
    """The face of a stretch of an item, as Azure's Voice Live names it."""
    rows = np.frombuffer(motion.face, "u1").reshape(motion.frames, -1)
    return {
        "type": "response.animation_blendshapes.delta",
        **_address(voice),
        "frames": [[round(value / 255, 3) for value in row] for row in rows.tolist()],
        "frame_index": voice.frame(chunk),
    }


def blendshapes_done(voice: Voice) -> Added:
    """The last frame of an item was sent."""
    return {"type": "response.animation_blendshapes.done", **_address(voice)}


def body(motion: Motion, voice: Voice | None, chunk: int = 0) -> Added:
    """The body; between utterances without an address, and with the face in it."""
    event = {
        "type": "echoavatar.animation_body.delta",
        **(_address(voice) if voice is not None else {"response_id": None, "item_id": None}),
        "frame_index": None if voice is None else voice.frame(chunk),
        "frames": motion.frames,
        "at": motion.at,
        "rotations": _text(motion.rotations),
        "root": _text(motion.root),
        "state": motion.state,
    }
    return event if voice is not None else event | {"face": _text(motion.face)}


def flush(told: Flush, voice: Voice | None) -> Added:
    """All frames from clock `at` on are void; of an item that was cut off, how much was heard."""
    event: Added = {"type": "echoavatar.flush", "at": told.at, "epoch": told.epoch}
    if voice is not None:
        event |= {"item_id": voice.item_id, "content_index": voice.content_index}
    return event


def music(at: int, pcm: Int16[np.ndarray, " s"]) -> Added:
    """Music to be heard beside the voice: 24 kHz, s16le, mono."""
    return {"type": "echoavatar.music.delta", "at": at, "delta": _text(pcm.astype("<i2").tobytes())}


def action_status(told: ActionStatus) -> Added:
    """What became of an action or of music."""
    return {
        "type": "echoavatar.action_status",
        "id": told.id,
        "name": told.name,
        "status": told.status,
        "at": told.at,
        "reason": told.reason,
    }


def _address(voice: Voice) -> Added:
    return {
        "response_id": voice.response_id,
        "item_id": voice.item_id,
        "output_index": voice.output_index,
        "content_index": voice.content_index,
    }


def _text(blob: bytes) -> str:
    return base64.b64encode(blob).decode()
