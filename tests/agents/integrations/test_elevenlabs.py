"""The ElevenLabs SDK's own conversations against a scripted service on this machine; no keys."""

import asyncio
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("elevenlabs", reason="pip install 'echoavatar[elevenlabs]'")

from elevenlabs import AsyncElevenLabs, ElevenLabs
from elevenlabs.conversational_ai.conversation import AsyncConversation, ClientTools, Conversation
from tests.agents.integrations.fakes import engine, tone, words_told
from tests.agents.integrations.service import Talk, service

from echoavatar.agents.integrations import AvatarChunk, Flushed
from echoavatar.agents.integrations.elevenlabs import AsyncAvatarAudioInterface, AvatarAudioInterface
from echoavatar.errors import AudioError


class Device:
    """A microphone, and a loudspeaker that records."""

    def __init__(self) -> None:
        self.heard = np.zeros(0, np.int16)
        self.interruptions = 0
        self.is_open = False
        self.speak_into: Callable[[bytes], Any] | None = None

    def start(self, input_callback: Callable[[bytes], Any]) -> None:
        self.is_open, self.speak_into = True, input_callback

    def stop(self) -> None:
        self.is_open = False

    def output(self, audio: bytes) -> None:
        self.heard = np.concatenate([self.heard, np.frombuffer(audio, "<i2")])

    def interrupt(self) -> None:
        self.interruptions += 1


def wait(what: Callable[[], bool], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.01)


class Scene:
    """A conversation of the SDK with an avatar in it."""

    def __init__(self, *, rate: int = 24_000, where: Any = None) -> None:
        self.device, self.events, self.rate = Device(), [], rate  # type: ignore[var-annotated]
        self.audio = AvatarAudioInterface(
            where or engine(), sample_rate=rate, device=self.device, on_event=self.events.append
        )
        self.tools = ClientTools()
        self.names = self.audio.register(self.tools)

    def of(self, kind: type) -> list[Any]:
        return [event for event in list(self.events) if isinstance(event, kind)]

    def converse(self, script: Callable[["Scene", Talk], None]) -> None:
        with service(lambda talk: script(self, talk)) as url:
            client = ElevenLabs(api_key="none", base_url=url)
            conversation = Conversation(
                client,
                "agent",
                requires_auth=False,
                audio_interface=self.audio,
                client_tools=self.tools,
                callback_audio_alignment=self.audio.align,
            )
            conversation.start_session()
            assert conversation.wait_for_session_end() == "c1"
        assert not self.device.is_open


@pytest.mark.parametrize("rate", [16_000, 24_000])
def test_the_agents_speech_is_heard_and_moves_the_body(rate: int) -> None:
    def script(scene: Scene, talk: Talk) -> None:
        talk.speak(tone(1.0, rate), rate)
        wait(lambda: np.count_nonzero(scene.device.heard) > 15_000)
        scene.device.speak_into(tone(0.25, 16_000).tobytes())
        while not talk.user_chunks:
            talk.read(10)

    scene = Scene(rate=rate)
    scene.converse(script)
    heard = scene.device.heard[4_000:12_000].astype(float)
    wanted = tone(1.0, 16_000)[4_000:12_000].astype(float)
    assert np.corrcoef(heard, wanted)[0, 1] > 0.99 or np.abs(heard).max() == pytest.approx(8_000, rel=0.05)
    assert {chunk.motion.state for chunk in scene.of(AvatarChunk)} >= {"speaking"}


def test_an_interruption_and_another_right_after() -> None:
    def script(scene: Scene, talk: Talk) -> None:
        talk.speak(tone(4.0, 24_000), 24_000)
        wait(lambda: len(scene.device.heard) > 12_000)
        talk.interrupt()
        talk.interrupt()
        wait(lambda: scene.device.interruptions == 2)
        wait(lambda: any(cut.is_interruption for cut in scene.of(Flushed)))
        count = len(scene.device.heard)
        time.sleep(0.7)
        assert len(scene.device.heard) - count < 200, "stale sound was heard"
        talk.speak(tone(4.0, 24_000), 24_000)
        wait(lambda: len(scene.device.heard) > count + 8_000)
        talk.interrupt()
        wait(lambda: len([cut for cut in scene.of(Flushed) if cut.is_interruption]) == 2)
        again = len(scene.device.heard)
        talk.speak(tone(0.5, 24_000), 24_000)
        wait(lambda: len(scene.device.heard) > again + 7_500)

    scene = Scene()
    scene.converse(script)
    first, second = [cut.flush for cut in scene.of(Flushed) if cut.is_interruption]
    assert (first.seg, second.seg) == (1, 2)
    assert 0 < first.heard < 3 * 24_000
    last = scene.events.index(scene.of(Flushed)[0])
    after = [event for event in scene.events[last + 1 :] if isinstance(event, AvatarChunk)]
    assert after[0].at == first.at


@pytest.mark.parametrize("rate", [16_000, 24_000])
def test_letters_of_the_speech_become_words_that_count_from_the_first_sample(rate: int) -> None:
    def script(scene: Scene, talk: Talk) -> None:
        talk.speak(tone(1.0, rate), rate, "Over ther", "e, ", "", "me")
        wait(lambda: len(told) == 3)  # the last word ends with the utterance
        talk.speak(tone(0.25, rate), rate, "you ")
        wait(lambda: len(told) == 4)
        time.sleep(0.6)  # a pause ends it
        talk.speak(tone(3.0, rate), rate, "but th")
        wait(lambda: len(told) == 5)
        talk.interrupt()
        wait(lambda: scene.device.interruptions == 1)
        talk.speak(tone(0.5, rate), rate, "is", " one ")
        wait(lambda: len(told) == 7)

    scene = Scene(rate=rate)
    told = words_told(scene.audio.avatar.bridge)
    scene.converse(script)
    assert told[:4] == [(1, "Over", 0.0), (1, "there,", 0.138), (1, "me", 0.75), (2, "you", 0.0)]
    assert told[4:] == [(3, "but", 0.0), (4, "is", 0.0), (4, "one", 0.3)]


def test_music_by_a_tool_goes_on_through_an_interruption() -> None:
    def script(scene: Scene, talk: Talk) -> None:
        told = talk.call("play_music")
        assert not told["is_error"]
        assert json.loads(told["result"])["status"] == "accepted"
        wait(lambda: len(scene.device.heard) > 16_000)
        talk.interrupt()
        talk.interrupt()
        count = len(scene.device.heard)
        wait(lambda: len(scene.device.heard) > count + 16_000)
        assert np.abs(scene.device.heard[-8_000:]).max() > 300

    scene = Scene()
    scene.converse(script)
    assert {chunk.motion.state for chunk in scene.of(AvatarChunk)} >= {"dancing"}


def test_tools_are_called_by_the_agent() -> None:
    def script(scene: Scene, talk: Talk) -> None:
        assert json.loads(talk.call("send_action", action="wave")["result"])["status"] == "accepted"
        refused = json.loads(talk.call("send_action", action="fly")["result"])
        assert refused["status"] == "rejected"
        assert "wave, bow" in refused["reason"]
        assert list(json.loads(talk.call("list_actions")["result"])["actions"]) == ["wave", "bow"]
        assert talk.call("dive")["is_error"], "the SDK's own answer to a tool that is not there"

    scene = Scene()
    assert scene.names == ("send_action", "play_music", "stop_music", "list_actions")
    scene.converse(script)


async def test_bytes_that_are_no_samples_are_told_once(caplog: pytest.LogCaptureFixture) -> None:
    audio = AsyncAvatarAudioInterface(engine(), sample_rate=24_000)
    for data in (b"ID3" + bytes(100), b"ID3" + bytes(100), bytes(3)):
        await audio.output(data)
    (record,) = caplog.records
    assert "pcm_24000" in record.getMessage()


@pytest.mark.parametrize("form", [12_345, "mp3_44100_128", "pcm", "opus_48000_32", "ulaw_16001"])
def test_a_format_that_is_none_of_samples_is_refused(form: int | str) -> None:
    with pytest.raises(AudioError, match="ulaw_8000"):
        AsyncAvatarAudioInterface(engine(), sample_rate=form)


@pytest.mark.parametrize(("form", "data"), [("ulaw_8000", bytes(8_000)), ("pcm_16000", tone(1.0, 16_000).tobytes())])
def test_speech_comes_in_any_pieces_and_in_telephone_codes(form: str, data: bytes) -> None:
    said: list[int] = []

    async def run() -> None:
        audio = AsyncAvatarAudioInterface(engine(), sample_rate=form)

        async def say(pcm: np.ndarray, rate: int) -> None:
            said.append(len(pcm) * 24_000 // rate)

        audio.bridge.say = say  # type: ignore[method-assign]
        speaking = asyncio.create_task(audio._speak())
        for start in range(0, len(data), 333):
            await audio.output(data[start : start + 333])
        await asyncio.sleep(0.1)
        speaking.cancel()

    asyncio.run(run())
    assert sum(said) == pytest.approx(24_000, abs=50)


def test_the_async_twin() -> None:
    class Microphone(Device):
        async def start(self, input_callback: Callable[[bytes], Any]) -> None:  # type: ignore[override]
            super().start(input_callback)

        async def output(self, audio: bytes) -> None:  # type: ignore[override]
            super().output(audio)

    device = Microphone()
    told: list[list[tuple[int, str, float]]] = []

    def script(talk: Talk) -> None:
        talk.speak(tone(2.0, 16_000), 16_000, "over ", "there ")
        wait(lambda: len(device.heard) > 8_000)
        assert json.loads(talk.call("send_action", action="bow")["result"])["status"] == "accepted"
        talk.interrupt()
        wait(lambda: device.interruptions == 1)

    async def run(url: str) -> None:
        audio = AsyncAvatarAudioInterface(engine(), sample_rate=16_000, device=device)
        tools = ClientTools(loop=asyncio.get_running_loop())
        await audio.register(tools)
        conversation = AsyncConversation(
            AsyncElevenLabs(api_key="none", base_url=url),
            "agent",
            requires_auth=False,
            audio_interface=audio,
            client_tools=tools,
            callback_audio_alignment=audio.align,
        )
        await audio.prepare()
        told.append(words_told(audio.bridge))
        await conversation.start_session()
        assert await conversation.wait_for_session_end() == "c1"

    with service(script) as url:
        asyncio.run(run(url))
    assert not device.is_open
    assert told[0] == [(1, "over", 0.0), (1, "there", 0.25)]


@pytest.mark.slow
def test_the_default_bundle_in_a_conversation() -> None:
    def script(scene: Scene, talk: Talk) -> None:
        talk.speak(tone(3.0, 24_000), 24_000)
        wait(lambda: len(scene.device.heard) > 16_000, 60)
        talk.interrupt()
        wait(lambda: bool(scene.of(Flushed)), 10)

    scene = Scene(where="default")
    scene.converse(script)
    rotations = [chunk.motion.rotations for chunk in scene.of(AvatarChunk)]
    assert len(set(rotations)) == len(rotations)
