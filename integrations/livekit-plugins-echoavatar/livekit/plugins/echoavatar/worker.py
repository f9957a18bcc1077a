"""An avatar in its own process. It joins a room, receives the agent's speech, and publishes sound and motion.

python -m livekit.plugins.echoavatar --url ws://127.0.0.1:7880 --token TOKEN
"""

import argparse
import asyncio
import os
from pathlib import Path

from livekit import rtc
from livekit.agents.voice.avatar import AudioReceiver, AvatarRunner, DataStreamAudioReceiver

from echoavatar import Engine
from echoavatar.agents.integrations import AvatarBridge, AvatarTools, find_backend
from echoavatar.files.avatar.avatar_renderer import Shot
from echoavatar.wire.messages import BodyOptions

from .avatar import SAMPLES, publish_sound
from .film import Film, runner
from .log import logger
from .motion import MotionChannel
from .performer import QUEUE_MS, Performer, Source
from .tools import answer_calls

FRAME_MS = 100


class AvatarWorker:
    """The avatar's half of `RemoteAvatarSession`, in a room that is connected."""

    def __init__(
        self,
        room: rtc.Room,
        where: str | Path | Engine = "default",
        *,
        token: str = "",
        seed: int = 0,
        body: BodyOptions | None = None,
        agent_identity: str | None = None,
        prefer_data_track: bool = True,
        source: Source | None = None,
        video: Shot | None = None,
        character: str = "",
    ) -> None:
        """Most arguments are those of `AvatarSession`; `agent_identity` is the agent to hear (default: the first one).

        `source` plays the sound instead of an audio track of the room.
        """
        self.room = room
        self.bridge = AvatarBridge(find_backend(where, token=token), seed=seed, body=body)
        self.receiver: AudioReceiver = DataStreamAudioReceiver(
            room, sender_identity=agent_identity, frame_size_ms=FRAME_MS
        )
        self._source = source
        self._prefer_track = prefer_data_track
        self._shot, self._character = video, character
        self._runner: AvatarRunner | None = None
        self._performer: Performer | None = None

    async def start(self) -> None:
        """Start; waits for the agent to join."""
        await self.bridge.start()
        tools = AvatarTools(self.bridge, await self.bridge.backend.tools())
        answer_calls(self.room, tools.schemas, tools.call)
        film: Film | None = None
        if self._shot is not None:
            self._source = film = await asyncio.to_thread(Film, self.bridge, self._shot, self._character)
            self._runner = runner(self.room, film)
            await self._runner.start()
        elif self._source is None:
            source = rtc.AudioSource(SAMPLES, 1, queue_size_ms=QUEUE_MS)
            await publish_sound(self.room, source)
            self._source = source
        channel = MotionChannel(self.room, prefer_track=self._prefer_track)
        self._performer = Performer(self.bridge, self.receiver, self._source, channel, film)
        self.room.on("participant_connected", self._greet)
        await self._performer.start()

    async def close(self) -> None:
        """End the session."""
        self.room.off("participant_connected", self._greet)
        await self.receiver.aclose()
        if self._runner is not None:
            await self._runner.aclose()
        if self._performer is not None:
            await self._performer.close()
        await self.bridge.close()

    def _greet(self, participant: rtc.RemoteParticipant) -> None:
        if self._performer is not None:
            self._performer.greet(participant.identity)


async def perform(url: str, token: str, where: str, where_token: str, video: int = 0) -> None:
    """Join the room and stay until it closes."""
    room, over = rtc.Room(), asyncio.Event()
    room.on("disconnected", lambda *_: over.set())
    await room.connect(url, token)
    worker = AvatarWorker(room, where, token=where_token, video=Shot((video, video)) if video else None)
    await worker.start()
    logger.info("the avatar is in room %s", room.name)
    try:
        await over.wait()
    finally:
        await worker.close()
        await room.disconnect()


def main() -> None:
    """Run the worker."""
    parser = argparse.ArgumentParser(prog="livekit.plugins.echoavatar", description=__doc__)
    parser.add_argument("--url", default=os.environ.get("LIVEKIT_URL", "ws://127.0.0.1:7880"))
    parser.add_argument("--token", required=True, help="of `RemoteAvatarSession.worker_token`")
    parser.add_argument("--avatar", default="default", help="a bundle, or a server's address")
    parser.add_argument("--avatar-token", default=os.environ.get("ECHOAVATAR_TOKEN", ""))
    parser.add_argument(
        "--video", nargs="?", type=int, const=512, default=0, metavar="PIXELS", help="also as a video track (512)"
    )
    args = parser.parse_args()
    try:
        asyncio.run(perform(args.url, args.token, args.avatar, args.avatar_token, args.video))
    except rtc.ConnectError as error:
        parser.exit(1, f"cannot join at {args.url}: {error}; check the server's address and the token\n")


if __name__ == "__main__":
    main()
