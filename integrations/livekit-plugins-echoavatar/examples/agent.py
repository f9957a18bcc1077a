"""A LiveKit agent with a body, in the agent's own process.

pip install 'livekit-agents[openai,silero]'
LIVEKIT_URL=... LIVEKIT_API_KEY=... LIVEKIT_API_SECRET=... OPENAI_API_KEY=... \
        python integrations/livekit-plugins-echoavatar/examples/agent.py dev
"""

import logging
import os

from livekit.agents import Agent, AgentSession, JobContext, WorkerOptions, cli
from livekit.agents.voice.room_io import RoomOptions
from livekit.plugins.echoavatar import AvatarSession

from echoavatar.agents.integrations.tools import persona


async def entrypoint(ctx: JobContext) -> None:
    """Handle one call."""
    from livekit.plugins import openai, silero

    await ctx.connect()
    session: AgentSession[None] = AgentSession(
        vad=silero.VAD.load(),
        stt=openai.STT(),
        llm=openai.LLM(),
        tts=openai.TTS(),
        resume_false_interruption=False,  # an avatar cannot be paused
    )
    avatar = AvatarSession(os.environ.get("ECHOAVATAR_SERVER", "default"), page_port=0)
    await avatar.start(session, room=ctx.room)
    logging.info("see it: %s", avatar.page)
    ready = avatar.bridge.ready
    agent = Agent(instructions=persona(ready.actions, ready.tracks), tools=avatar.tools)
    await session.start(agent=agent, room=ctx.room, room_options=RoomOptions(audio_output=False))


if __name__ == "__main__":
    if not os.environ.get("OPENAI_API_KEY"):
        raise SystemExit("set OPENAI_API_KEY: OpenAI hears, thinks and speaks here")
    cli.run_app(WorkerOptions(entrypoint_fnc=entrypoint))
