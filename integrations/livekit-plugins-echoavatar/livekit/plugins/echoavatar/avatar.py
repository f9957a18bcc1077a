"""Two ways to give an agent an avatar: in its own process, or through a worker that joins the room."""

import asyncio
import time
from pathlib import Path
from typing import Any

from livekit import api, rtc
from livekit.agents import AgentSession, utils
from livekit.agents.llm import RawFunctionTool
from livekit.agents.metrics.base import AvatarMetrics, Metadata
from livekit.agents.types import ATTRIBUTE_PUBLISH_ON_BEHALF
from livekit.agents.voice.avatar import AvatarRunner, DataStreamAudioOutput, QueueAudioOutput
from livekit.agents.voice.avatar import AvatarSession as BaseAvatarSession

from echoavatar import Engine
from echoavatar.agents.integrations import AvatarBridge, AvatarTools, find_backend
from echoavatar.files.avatar.avatar_renderer import Shot
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.messages import BodyOptions

from .film import Film, runner
from .motion import MotionChannel
from .performer import QUEUE_MS, Performer
from .tools import ask_for_tools, function_tools

PROVIDER = "echoavatar"
SAMPLES = SAMPLE_RATE_HZ


class _Session(BaseAvatarSession[Any]):
    """Shared by both ways. No video track is published, so joining does not wait for one."""

    @property
    def provider(self) -> str:
        """The name of the avatar's provider, for metrics."""
        return PROVIDER

    async def _wait_avatar_join(self) -> None:
        assert self._room is not None
        began = time.time()
        await utils.wait_for_participant(room=self._room, identity=self.avatar_identity, include_local=True)
        joined = time.time()
        metadata = Metadata(model_provider=PROVIDER)
        self._emit_metrics(
            AvatarMetrics(timestamp=joined, session_started_time=began, avatar_joined_time=joined, metadata=metadata)
        )


class AvatarSession(_Session):
    """An avatar in the agent's process; the agent itself publishes its sound and motion.

    >>> avatar = AvatarSession("default")  # or a server: AvatarSession("http://127.0.0.1:8765")
    >>> await avatar.start(session, room=ctx.room)
    >>> await session.start(
    ...     agent=Agent(..., tools=avatar.tools), room=ctx.room, room_options=RoomOptions(audio_output=False)
    ... )
    """

    def __init__(
        self,
        where: str | Path | Engine = "default",
        *,
        token: str = "",
        seed: int = 0,
        body: BodyOptions | None = None,
        page_port: int | None = None,
        prefer_data_track: bool = True,
        video: Shot | None = None,
        character: str = "",
    ) -> None:
        """`where`: a server's address, or a bundle's name or folder, or an engine, which then runs in this process.

        `page_port` serves the live page of an engine that runs here; `token` is the server's. `body`, such as
        `BodyOptions(leash_m=0.5)`, keeps the avatar near its place. With `video`, such as `Shot((512, 512))`, the
        avatar is drawn here and published as a video track; `character` says who.
        """
        super().__init__()
        self.bridge = AvatarBridge(find_backend(where, token=token, port=page_port), seed=seed, body=body)
        self._prefer_track = prefer_data_track
        self._shot, self._character = video, character
        self._runner: AvatarRunner | None = None
        self._performer: Performer | None = None
        self._tools: AvatarTools | None = None
        self._source: rtc.AudioSource | None = None
        self._publication: rtc.LocalTrackPublication | None = None

    @property
    def avatar_identity(self) -> str:
        """The agent's own identity, because no other participant joins."""
        return self._room.local_participant.identity if self._room is not None else PROVIDER

    @property
    def page(self) -> str:
        """Address of a page that shows the avatar; empty if there is none."""
        return self.bridge.page

    @property
    def tools(self) -> list[RawFunctionTool[Any, Any]]:
        """Tools for `Agent(tools=...)`; known after `start` or `prepare`."""
        if self._tools is None:
            raise RuntimeError("the avatar's tools are not known yet; await avatar.prepare() first")
        return function_tools(self._tools.schemas, self._tools.call)

    async def prepare(self) -> None:
        """Open the session early, so that tools and page are known and the model is loaded before the conversation."""
        await self.bridge.start()
        if self._tools is None:
            self._tools = AvatarTools(self.bridge, await self.bridge.backend.tools())

    async def start(self, agent_session: AgentSession, room: rtc.Room) -> None:
        """Replace the agent's audio output by the avatar's."""
        await super().start(agent_session, room)
        await self.prepare()
        sink = QueueAudioOutput(wait_playback_start=True)  # at the voice's own rate: resampling loses words
        channel = MotionChannel(room, prefer_track=self._prefer_track)
        agent_session.output.replace_audio_tail(sink)
        if self._shot is not None:
            film = await asyncio.to_thread(Film, self.bridge, self._shot, self._character)
            self._performer = Performer(self.bridge, sink, film, channel, film)
            self._runner = runner(room, film)
            await self._runner.start()
        else:
            self._source = rtc.AudioSource(SAMPLES, 1, queue_size_ms=QUEUE_MS)
            self._performer = Performer(self.bridge, sink, self._source, channel)
            if room.isconnected():
                self._publication = await publish_sound(room, self._source)
        await self._performer.start()
        room.on("participant_connected", self._greet)

    async def aclose(self) -> None:
        """End the session. The agent stays in the room; the base class would make the avatar's identity leave."""
        room, self._room = self._room, None
        if room is not None:
            room.off("participant_connected", self._greet)
            room.off("connection_state_changed", self._on_connection_state_changed)
            if self._publication is not None and room.isconnected():
                await room.local_participant.unpublish_track(self._publication.sid)
        if self._runner is not None:
            await self._runner.aclose()
        if self._performer is not None:
            await self._performer.close()
        await self.bridge.close()
        if self._source is not None:
            await self._source.aclose()
        await super().aclose()

    def _greet(self, participant: rtc.RemoteParticipant) -> None:
        if self._performer is not None:
            self._performer.greet(participant.identity)


class RemoteAvatarSession(_Session):
    """The agent's half of an avatar that runs in a worker (`AvatarWorker`); speech goes there over a data stream.

    >>> avatar = RemoteAvatarSession()
    >>> token = avatar.worker_token("my-room", agent_identity, api_key=..., api_secret=...)
    >>> await avatar.start(session, room=ctx.room)  # python -m livekit.plugins.echoavatar --token ...
    """

    def __init__(self, *, avatar_identity: str = "echoavatar") -> None:
        super().__init__()
        self._identity = avatar_identity

    @property
    def avatar_identity(self) -> str:
        """The identity under which the worker joins."""
        return self._identity

    def worker_token(self, room: str, agent_identity: str, *, api_key: str, api_secret: str) -> str:
        """The token with which the worker joins; it allows publishing on behalf of the agent."""
        return (
            api.AccessToken(api_key, api_secret)
            .with_kind("agent")
            .with_identity(self._identity)
            .with_name("EchoAvatar")
            .with_grants(api.VideoGrants(room_join=True, room=room, can_publish_data=True))
            .with_attributes({ATTRIBUTE_PUBLISH_ON_BEHALF: agent_identity})
            .to_jwt()
        )

    async def start(self, agent_session: AgentSession, room: rtc.Room) -> None:
        """Send the agent's speech to the worker; the stream waits until the worker has joined."""
        await super().start(agent_session, room)
        agent_session.output.replace_audio_tail(
            DataStreamAudioOutput(
                room,
                destination_identity=self._identity,
                sample_rate=SAMPLES,
                wait_playback_start=True,
                clear_buffer_timeout=2.0,
            )
        )

    async def tools(self) -> list[RawFunctionTool[Any, Any]]:
        """Tools for `Agent(tools=...)`, requested from the worker, which must be in the room."""
        if self._room is None:
            raise RuntimeError("start the avatar first; its tools are asked for in the room")
        return await ask_for_tools(self._room, self._identity)


async def publish_sound(room: rtc.Room, source: rtc.AudioSource) -> rtc.LocalTrackPublication:
    """Publish the avatar's sound as an agent's voice is published."""
    track = rtc.LocalAudioTrack.create_audio_track("echoavatar", source)
    options = rtc.TrackPublishOptions(source=rtc.TrackSource.SOURCE_MICROPHONE)
    return await room.local_participant.publish_track(track, options)
