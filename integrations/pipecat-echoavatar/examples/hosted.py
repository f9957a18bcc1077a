"""A bot that you can talk to in the browser over WebRTC: OpenAI hears, thinks and speaks, and the avatar moves.

    pip install 'pipecat-ai[webrtc,runner,silero,openai]'
    OPENAI_API_KEY=... python integrations/pipecat-echoavatar/examples/hosted.py --transport webrtc

Any other services fit in the same places. The browser's client receives motion as RTVI server messages; the address
that is printed shows the avatar as well.
"""

import os
import sys

from pipecat.adapters.llm.schemas.tools_schema import ToolsSchema
from pipecat.audio.vad.silero import SileroVADAnalyzer
from pipecat.pipeline.pipeline import Pipeline
from pipecat.pipeline.worker import PipelineWorker
from pipecat.processors.aggregators.llm_context import LLMContext
from pipecat.processors.aggregators.llm_response_universal import LLMContextAggregatorPair, LLMUserAggregatorParams
from pipecat.processors.frame_processor import FrameProcessor
from pipecat.services.openai.llm import OpenAILLMService
from pipecat.services.openai.stt import OpenAISTTService
from pipecat.services.openai.tts import OpenAITTSService
from pipecat.workers.runner import WorkerRunner
from pipecat_echoavatar import EchoAvatarProcessor

from echoavatar.agents.integrations.tools import persona


async def build(source: FrameProcessor, sink: FrameProcessor, avatar: EchoAvatarProcessor) -> PipelineWorker:
    """Build the bot between the two ends of a transport."""
    await avatar.prepare()
    ready = avatar.bridge.ready
    prompt = persona(ready.actions, ready.tracks)
    context = LLMContext([{"role": "system", "content": prompt}], tools=ToolsSchema(standard_tools=avatar.tools))
    user, assistant = LLMContextAggregatorPair(
        context, user_params=LLMUserAggregatorParams(vad_analyzer=SileroVADAnalyzer())
    )
    key = os.environ["OPENAI_API_KEY"]
    services = (
        source,
        OpenAISTTService(api_key=key),
        user,
        OpenAILLMService(api_key=key),
        OpenAITTSService(api_key=key),
        avatar,  # after the voice, before the transport
        sink,
        assistant,
    )
    return PipelineWorker(Pipeline(list(services)))


async def bot(runner_args: object) -> None:
    """Run for every visitor; called by Pipecat's runner."""
    from pipecat.runner.utils import create_transport
    from pipecat.transports.base_transport import TransportParams

    params = {"webrtc": lambda: TransportParams(audio_in_enabled=True, audio_out_enabled=True)}
    transport = await create_transport(runner_args, params)
    avatar = EchoAvatarProcessor(os.environ.get("ECHOAVATAR_SERVER", "default"), page_port=0)
    worker = await build(transport.input(), transport.output(), avatar)
    print("see it:", avatar.page, file=sys.stderr)
    runner = WorkerRunner()
    await runner.add_workers(worker)
    await runner.run()


if __name__ == "__main__":
    if not os.environ.get("OPENAI_API_KEY"):
        raise SystemExit("set OPENAI_API_KEY: OpenAI hears, thinks and speaks here")

    from pipecat.runner.run import main

    main()
