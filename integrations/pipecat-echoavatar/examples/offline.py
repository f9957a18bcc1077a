"""A talking avatar without network or keys: you type, and it answers with this machine's voice.

    python integrations/pipecat-echoavatar/examples/offline.py

Open the address it prints; the page shows the avatar and is its loudspeaker. The avatar obeys words such as wave, bow,
dance and stop, and a line typed while it speaks interrupts it. It speaks with
a voice of this machine (`pip install 'echoavatar[voice]'`, flite, espeak-ng or say).
"""

import argparse
import asyncio
import sys
from collections.abc import AsyncGenerator

from pipecat.frames.frames import EndFrame, Frame, InterruptionFrame, TTSAudioRawFrame, TTSSpeakFrame
from pipecat.pipeline.pipeline import Pipeline
from pipecat.pipeline.worker import PipelineWorker
from pipecat.services.settings import TTSSettings
from pipecat.services.tts_service import TTSService
from pipecat.workers.runner import WorkerRunner
from pipecat_echoavatar import EchoAvatarProcessor, NullTransport

from echoavatar.agents.integrations import AvatarTools
from echoavatar.server.voice import find_voice, speak
from echoavatar.timing import SAMPLE_RATE_HZ


class LocalVoice(TTSService):
    """Speaks with this machine's voice."""

    def __init__(self) -> None:
        super().__init__(
            settings=TTSSettings(model=None, voice=None, language=None), push_start_frame=True, push_stop_frames=True
        )
        if not find_voice():
            raise SystemExit("no voice here; pip install 'echoavatar[voice]'")

    async def run_tts(self, text: str, context_id: str) -> AsyncGenerator[Frame | None, None]:
        """Speak a sentence."""
        sentences = speak(text)
        while said := await asyncio.to_thread(next, sentences, None):
            pcm = (said.samples * 32767).astype("<i2").tobytes()
            yield TTSAudioRawFrame(audio=pcm, sample_rate=SAMPLE_RATE_HZ, num_channels=1, context_id=context_id)


async def obey(line: str, tools: AvatarTools) -> str:
    """Do what the line asks for; returns what the avatar says about it."""
    words = set(line.lower().replace(",", " ").replace(".", " ").split())
    if words & {"stop", "quiet", "silence"}:
        await tools.call("stop_music", {})
        return "Fine. I will stand still, for once."
    if words & {"music", "dance", "song"}:
        result = await tools.call("play_music", {})
        return f"Oh, this one is mine. {result.get('title', '')}!"
    actions = next(schema for schema in tools.schemas if schema["name"] == "send_action")
    for action in actions["parameters"]["properties"]["action"]["enum"]:
        if action in words or action.replace("_", " ") in line.lower():
            await tools.call("send_action", {"action": action})
            return "Like this? Of course like this."
    return f"You said: {line}. And I say it with my hands, too."


async def main() -> None:
    """Talk until the input ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--avatar", default="default", help="a bundle, or the address of a running server")
    parser.add_argument("--port", type=int, default=8770, help="of the page (default: %(default)s)")
    args = parser.parse_args()
    avatar = EchoAvatarProcessor(args.avatar, page_port=args.port)
    worker = PipelineWorker(Pipeline([LocalVoice(), avatar, NullTransport()]), cancel_on_idle_timeout=False)
    await avatar.prepare()
    print(f"see and hear it: {avatar.page}\ntype something; an empty line or Ctrl+D ends", flush=True)

    async def read() -> None:
        while line := (await asyncio.to_thread(sys.stdin.readline)).strip():
            await worker.queue_frame(InterruptionFrame())
            answer = await obey(line, avatar.tool_calls)
            print(answer, flush=True)
            await worker.queue_frame(TTSSpeakFrame(answer))
        await asyncio.sleep(0.5)
        while avatar.bridge.is_busy:  # noqa: ASYNC110
            await asyncio.sleep(0.1)
        await worker.queue_frame(EndFrame())

    runner = WorkerRunner()
    await runner.add_workers(worker)
    reading = asyncio.create_task(read())
    await runner.run()
    reading.cancel()


if __name__ == "__main__":
    asyncio.run(main())
