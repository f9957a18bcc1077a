"""Talk with an ElevenLabs agent that has a body: microphone and loudspeaker here, the avatar on a page.

pip install 'echoavatar[elevenlabs]' 'elevenlabs[pyaudio]'
echoavatar elevenlabs setup --name idol           # prints the agent's id
ELEVENLABS_API_KEY=... python integrations/elevenlabs/examples/talk.py AGENT_ID
"""

import os
import sys

from elevenlabs import ElevenLabs
from elevenlabs.conversational_ai.conversation import ClientTools, Conversation
from elevenlabs.conversational_ai.default_audio_interface import DefaultAudioInterface

from echoavatar.agents.integrations.elevenlabs import AvatarAudioInterface


def main() -> None:
    """Run until the agent or Ctrl+C ends the conversation."""
    if len(sys.argv) != 2 or not os.environ.get("ELEVENLABS_API_KEY"):
        raise SystemExit(
            "usage: ELEVENLABS_API_KEY=... python talk.py AGENT_ID\n`echoavatar elevenlabs setup` prints the id"
        )
    audio = AvatarAudioInterface("default", sample_rate=16_000, device=DefaultAudioInterface(), page_port=8770)
    tools = ClientTools()
    audio.register(tools)
    print("see it:", audio.page)
    conversation = Conversation(
        ElevenLabs(api_key=os.environ["ELEVENLABS_API_KEY"]),
        sys.argv[1],
        requires_auth=True,
        audio_interface=audio,
        client_tools=tools,
        callback_audio_alignment=audio.align,
    )
    conversation.start_session()
    conversation.wait_for_session_end()


if __name__ == "__main__":
    main()
