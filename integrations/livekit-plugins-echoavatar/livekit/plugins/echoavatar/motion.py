"""Send motion over a data track (lossy, ordered, timestamped), or as reliable data if there is no track."""

import asyncio
import time
from collections.abc import Coroutine
from typing import Any

from livekit import rtc

from echoavatar.wire.codec import encode
from echoavatar.wire.messages import Motion, ServerMessage

from .log import logger

MOTION_TOPIC = "echoavatar.motion"  # name of the track, and topic of reliable data
TOPIC = "echoavatar"  # topic of all other messages: rare, and must arrive
TIMEOUT_S = 5.0


class MotionChannel:
    """Sends messages of protocol `echoavatar.v1`, as MessagePack, to the participants of a room."""

    def __init__(self, room: rtc.Room, *, prefer_track: bool = True) -> None:
        self._room, self._prefer_track = room, prefer_track
        self._track: rtc.LocalDataTrack | None = None
        self._sending: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Publish the track; without one, reliable data is used."""
        if not self._prefer_track:
            return
        try:
            publishing = self._room.local_participant.publish_data_track(name=MOTION_TOPIC)
            self._track = await asyncio.wait_for(publishing, TIMEOUT_S)
        except Exception as error:  # an old server, an old SDK or a missing permission each raise something else
            logger.info("no data track (%s); motion goes as reliable data", error)

    def show(self, motion: Motion, *, due_s: float) -> None:
        """Send frames that are due in `due_s` seconds; the track's timestamp says when, in microseconds."""
        payload = encode(motion)
        if self._track is not None:
            when = max(0, round((time.time() + due_s) * 1e6))
            try:
                self._track.try_push(rtc.DataTrackFrame(payload=payload, user_timestamp=when))
                return
            except rtc.PushFrameError as error:
                if not self._track.is_published():
                    logger.warning("the data track is gone (%s); motion goes as reliable data", error)
                    self._track = None
                else:
                    return  # the track is full, and it is lossy on purpose
        self._send(self._room.local_participant.publish_data(payload, reliable=True, topic=MOTION_TOPIC))

    def tell(self, message: ServerMessage, *, to: str = "") -> None:
        """Send any other message, to all participants or to one."""
        destinations = [to] if to else []
        self._send(
            self._room.local_participant.publish_data(
                encode(message), reliable=True, topic=TOPIC, destination_identities=destinations
            )
        )

    async def close(self) -> None:
        """Unpublish the track."""
        for task in self._sending:
            task.cancel()
        if self._track is not None:
            await self._track.unpublish()
            self._track = None

    def _send(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(_quietly(work))
        self._sending.add(task)
        task.add_done_callback(self._sending.discard)


async def _quietly(work: Coroutine[Any, Any, None]) -> None:
    try:
        await work
    except Exception as error:  # the room may have closed meanwhile; the voice must not be affected
        logger.debug("a message was not sent: %s", error)
