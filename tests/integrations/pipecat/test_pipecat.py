"""The processor in Pipecat's own harness and output transport; no network, no keys."""

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pipecat", reason="pip install ./integrations/pipecat-echoavatar")
pytest.importorskip("pipecat_echoavatar", reason="pip install ./integrations/pipecat-echoavatar")

from loguru import logger
from pipecat.frames.frames import (
    InputAudioRawFrame,
    InputTransportMessageFrame,
    InterruptionFrame,
    OutputAudioRawFrame,
    OutputTransportMessageFrame,
    TTSAudioRawFrame,
    TTSSpeakFrame,
    TTSStartedFrame,
    TTSStoppedFrame,
    TTSTextFrame,
)
from pipecat.tests.utils import SleepFrame, run_test
from pipecat_echoavatar import AvatarSpeechFrame, EchoAvatarProcessor
from tests.agents.integrations.fakes import words_told
from tests.integrations.pipecat.scene import Scene, Voice, engine, play, tone

from echoavatar.agents.integrations import AvatarTools
from echoavatar.engine.music import Tracks
from echoavatar.engine.pipeline.actions import ActionLibrary
from echoavatar.engine.tools import Toolbox


def test_motion_comes_before_the_sound_it_belongs_to_and_no_sound_is_lost() -> None:
    said = tone(1.0)
    down, _ = asyncio.run(
        run_test(
            EchoAvatarProcessor(engine()),
            frames_to_send=[
                TTSStartedFrame(),
                *[
                    TTSAudioRawFrame(audio=said[k : k + 9_600], sample_rate=24_000, num_channels=1)
                    for k in range(0, len(said), 9_600)
                ],
                TTSStoppedFrame(),
                SleepFrame(2.0),
            ],
            start_timeout=60,
        )
    )
    heard = b"".join(frame.audio for frame in down if isinstance(frame, AvatarSpeechFrame))
    sent, got = np.frombuffer(said, "<i2"), np.frombuffer(heard, "<i2")
    np.testing.assert_allclose(got[: len(sent)], sent, atol=1)
    assert len(got) < len(sent) + 6_400
    assert not got[len(sent) :].any()
    chunks = [k for k, frame in enumerate(down) if isinstance(frame, AvatarSpeechFrame)]
    for k in chunks:
        before = down[k - 1]
        assert isinstance(before, OutputTransportMessageFrame)
        motion = before.message["data"]["message"]
        assert motion["type"] == "motion"
        assert motion["frames"] * 800 == len(down[k].audio) // 2
    assert not any(isinstance(frame, TTSAudioRawFrame) and k not in chunks for k, frame in enumerate(down))
    ends = [k for k, frame in enumerate(down) if isinstance(frame, TTSStoppedFrame)]
    assert ends == [k for k in ends if k > chunks[-1]]
    assert len(ends) == 1


def test_samples_that_a_service_cuts_in_two_and_beside_each_other_are_heard_whole() -> None:
    said = np.frombuffer(tone(0.8), "<i2")
    data = np.repeat(said[:, None], 2, axis=1).tobytes()
    pieces = [
        TTSAudioRawFrame(audio=data[k : k + 4_801], sample_rate=24_000, num_channels=2)
        for k in range(0, len(data), 4_801)
    ]
    down, _ = asyncio.run(
        run_test(
            EchoAvatarProcessor(engine()),
            frames_to_send=[TTSStartedFrame(), *pieces, TTSStoppedFrame(), SleepFrame(2.0)],
            start_timeout=60,
        )
    )
    heard = b"".join(frame.audio for frame in down if isinstance(frame, AvatarSpeechFrame))
    np.testing.assert_allclose(np.frombuffer(heard, "<i2")[: len(said)], said, atol=1)
    assert [frame for frame in down if isinstance(frame, TTSStoppedFrame)]


def test_sound_that_is_not_called_speech_passes_and_is_told_once() -> None:
    told: list[str] = []
    sink = logger.add(told.append, level="WARNING", format="{message}")
    beep = OutputAudioRawFrame(audio=tone(0.2), sample_rate=24_000, num_channels=1)
    down, _ = asyncio.run(
        run_test(EchoAvatarProcessor(engine()), frames_to_send=[beep, beep, SleepFrame(0.5)], start_timeout=60)
    )
    logger.remove(sink)
    assert sum(type(frame) is OutputAudioRawFrame for frame in down) == 2
    (line,) = [line for line in told if "TTSAudioRawFrame" in line]
    assert "OutputAudioRawFrame" in line


def test_frames_behind_speech_stay_behind_it() -> None:
    def word(text: str) -> TTSTextFrame:
        return TTSTextFrame(text, text_type="word")

    half = TTSAudioRawFrame(audio=tone(0.6), sample_rate=24_000, num_channels=1)
    other = TTSAudioRawFrame(audio=tone(0.6), sample_rate=24_000, num_channels=1)
    down, _ = asyncio.run(
        run_test(
            EchoAvatarProcessor(engine()),
            frames_to_send=[
                word("before"),
                half,
                word("between"),
                other,
                word("after"),
                TTSStoppedFrame(),
                SleepFrame(2.0),
            ],
            start_timeout=60,
        )
    )
    samples, passed = 0, {}
    for frame in down:
        if isinstance(frame, AvatarSpeechFrame):
            samples += frame.num_frames
        elif isinstance(frame, TTSTextFrame):
            passed[frame.text] = samples
    assert passed["before"] == 0
    assert 0.6 * 24_000 <= passed["between"] <= 0.6 * 24_000 + 6_400
    assert 1.2 * 24_000 <= passed["after"] <= 1.2 * 24_000 + 6_400


def test_words_count_from_the_first_sample_of_their_utterance() -> None:
    """Two utterances at once: the second's words wait for its sound. Then one that is interrupted, and another."""
    told: list[tuple[int, str, float]] = []

    async def script(scene: Scene) -> None:
        nonlocal told
        told = words_told(scene.avatar.bridge)
        await scene.push(TTSSpeakFrame("Put it over there now."), TTSSpeakFrame("But you and me."))
        await scene.until(lambda: len(told) == 9, 30)
        await scene.push(TTSSpeakFrame("This is gone before it ends."))
        await scene.until(lambda: len(told) > 10, 30)
        await scene.push(InterruptionFrame())
        await asyncio.sleep(0.2)
        scene.before = len(told)  # type: ignore[attr-defined]
        await scene.push(TTSSpeakFrame("You are here."))
        await scene.until(lambda: len(told) == scene.before + 3, 30)  # type: ignore[attr-defined]

    play(script, before=[Voice()])
    spoken = {seg: [(word, at) for number, word, at in told if number == seg] for seg in (1, 2, 3, 4)}
    assert [" ".join(word for word, _ in spoken[seg]) for seg in (1, 2, 4)] == [
        "Put it over there now.",
        "But you and me.",
        "You are here.",
    ]
    assert 0 < len(spoken[3]) < 6
    for words in spoken.values():
        assert [at for _, at in words] == pytest.approx([0.5 * k for k in range(len(words))], abs=0.04)


def test_a_context_that_goes_on_in_an_utterance_counts_from_its_own_sound() -> None:
    told: list[tuple[int, str, float]] = []

    def word(text: str, at_s: float, context: str, *, spaced: bool = False) -> TTSTextFrame:
        frame = TTSTextFrame(text, text_type="word", context_id=context)
        frame.pts, frame.includes_inter_frame_spaces = round(1e9 * at_s), spaced
        return frame

    def sound(seconds: float, context: str) -> TTSAudioRawFrame:
        return TTSAudioRawFrame(audio=tone(seconds), sample_rate=24_000, num_channels=1, context_id=context)

    async def script(scene: Scene) -> None:
        nonlocal told
        told = words_told(scene.avatar.bridge)
        far = scene.avatar.get_clock().get_time() / 1e9 + 3.0  # so the second context begins with this word
        first = [sound(0.1, "a"), word("Over", far, "a"), sound(3.9, "a")]
        await scene.push(*first, sound(1.0, "b"), word("the", far + 0.5, "b", spaced=True))
        await scene.push(word("re ", far + 0.6, "b", spaced=True), word("no time", 0, "b"), TTSStoppedFrame())
        await scene.until(lambda: len(told) == 2, 30)

    play(script)
    assert [word for _, word, _ in told] == ["Over", "there"]
    assert told[1][2] == pytest.approx(4.5, abs=1e-3)


def test_any_rate_is_spoken() -> None:
    said = TTSAudioRawFrame(audio=tone(1.0, rate=16_000), sample_rate=16_000, num_channels=1)
    down, _ = asyncio.run(
        run_test(
            EchoAvatarProcessor(engine()),
            frames_to_send=[TTSStartedFrame(), said, TTSStoppedFrame(), SleepFrame(2.0)],
            start_timeout=60,
        )
    )
    sound = np.concatenate(
        [np.frombuffer(frame.audio, "<i2") for frame in down if isinstance(frame, AvatarSpeechFrame)]
    )
    wanted = np.frombuffer(tone(1.0), "<i2").astype(float)
    middle = slice(2_000, 22_000)
    np.testing.assert_allclose(sound[middle], wanted[middle], atol=80)


def _after(seen: list[Any], kind: str) -> list[Any]:
    last = max(k for k, (_, name, _) in enumerate(seen) if name == kind)
    return seen[last + 1 :]


def test_an_interruption_stops_speech_where_it_was_heard() -> None:
    """Three seconds of speech, cut after about one: the cut lies within two blocks of what the transport wrote."""

    async def script(scene: Scene) -> None:
        await scene.speak(3.0)
        await scene.until(lambda: len(scene.transport.sound) > 24_000)
        await scene.push(InterruptionFrame())
        await scene.until(lambda: bool(scene.transport.messages("flush")))
        await asyncio.sleep(0.6)

    transport = play(script)
    flush = transport.messages("flush")[-1]
    assert flush["seg"] == 1
    assert abs(flush["heard"] - len(transport.sound)) <= 2 * 960
    rest = _after(transport.seen, "flush")
    assert not [name for _, name, _ in rest if name == "AvatarSpeechFrame"]
    motion = [what for _, name, what in rest if name == "motion"]
    assert motion, "the avatar froze"
    assert all(what["epoch"] == flush["epoch"] for what in motion)
    assert motion[0]["at"] == flush["at"]


def test_interrupted_twice_in_a_row_it_speaks_again() -> None:
    async def script(scene: Scene) -> None:
        await scene.speak(3.0)
        await scene.until(lambda: len(scene.transport.sound) > 12_000)
        await scene.push(InterruptionFrame())
        await scene.push(InterruptionFrame())
        await scene.speak(3.0)
        before = len(scene.transport.sound)
        await scene.until(lambda: len(scene.transport.sound) > before + 12_000)
        await scene.push(InterruptionFrame())
        await asyncio.sleep(0.3)
        quiet = len(scene.transport.sound)
        await scene.speak(0.5)
        await scene.until(lambda: len(scene.transport.sound) >= quiet + 12_000)
        await asyncio.sleep(0.5)

    transport = play(script)
    assert [flush["seg"] for flush in transport.messages("flush")] == [1, 2]
    spoken = np.frombuffer(tone(0.5), "<i2")
    tail = transport.sound
    tail = tail[: np.flatnonzero(tail)[-1] + 1]
    np.testing.assert_allclose(tail[-len(spoken) + 1 :], spoken[1:], atol=1)


def test_music_passes_through_the_avatar_and_goes_on_where_it_was_interrupted() -> None:
    """The transport drops its queue; the music continues from the last block that it wrote."""
    title = Tracks().titles[0]
    track = Tracks().load(title)

    async def script(scene: Scene) -> None:
        result = await scene.avatar.tool_calls.call("play_music", {"title": title})
        assert result == {"title": title, "status": "accepted"}
        await scene.until(lambda: len(scene.transport.sound) > 30_000)
        await scene.push(InterruptionFrame())
        await scene.push(InterruptionFrame())
        before = len(scene.transport.sound)
        await scene.until(lambda: len(scene.transport.sound) > before + 30_000)

    transport = play(script)
    names = {name for _, name, what in transport.seen if isinstance(what, bytes)}
    assert names == {"AvatarMusicFrame"}, "music alone is no speech of the bot's"
    assert {motion["state"] for motion in transport.messages("motion")} >= {"dancing"}
    sound = transport.sound.astype(float) / 32_767
    np.testing.assert_allclose(sound[:24_000], track[:24_000], atol=1e-3)
    tail = sound[-20_000:-8_000]
    lags = range(-12_000, 12_001)  # a busy machine leaves gaps in what is heard
    middle = len(sound) - 20_000
    fits = [np.median(np.abs(track[middle + lag : middle + lag + 12_000] - tail)) for lag in lags]
    assert min(fits) < 1e-3, "after the interruption it is another music"
    assert abs(lags[int(np.argmin(fits))]) <= 2 * 960 + 800, "it jumped"


def test_speech_over_music_is_one_sound() -> None:
    async def script(scene: Scene) -> None:
        await scene.avatar.tool_calls.call("play_music", {})
        await scene.until(lambda: len(scene.transport.sound) > 12_000)
        await scene.speak(0.8)
        await scene.until(lambda: any(name == "AvatarSpeechFrame" for _, name, _ in scene.transport.seen))
        await asyncio.sleep(0.5)
        await scene.push(InterruptionFrame())
        await asyncio.sleep(1.0)

    transport = play(script)
    names = [name for _, name, what in transport.seen if isinstance(what, bytes)]
    assert names[-1] == "AvatarMusicFrame", "the speech is gone, the music plays on"


def test_a_client_that_comes_late_is_told_of_the_rig() -> None:
    async def script(scene: Scene) -> None:
        await scene.until(lambda: bool(scene.transport.messages("ready")))
        ready = {"label": "rtvi-ai", "type": "client-ready", "id": "1", "data": {}}
        await scene.push(InputTransportMessageFrame(message=ready))
        await scene.until(lambda: len(scene.transport.messages("ready")) > 1)

    ready = play(script).messages("ready")[-1]
    assert len(ready["rig"]["names"]) == 52
    assert ready["actions"] == ("wave", "bow")


def test_the_avatar_listens_to_the_user() -> None:
    async def script(scene: Scene) -> None:
        for _ in range(20):
            frame = InputAudioRawFrame(audio=tone(0.1, 16_000, 12_000), sample_rate=16_000, num_channels=1)
            await scene.push(frame)
            await asyncio.sleep(0.05)
        await scene.until(lambda: any(m["state"] == "listening" for m in scene.transport.messages("motion")))

    play(script)


def test_tools_list_the_avatars_actions_and_are_silent() -> None:
    answers: list[Any] = []

    class Params:
        def __init__(self, name: str, arguments: dict[str, Any]) -> None:
            self.function_name, self.arguments = name, arguments

        async def result_callback(self, result: Any, *, properties: Any = None) -> None:
            answers.append((result, properties))

    async def script(scene: Scene) -> None:
        schemas = {schema.name: schema for schema in scene.avatar.tools}
        assert set(schemas) == {"send_action", "play_music", "stop_music", "list_actions"}
        assert schemas["send_action"].properties["action"]["enum"] == ["wave", "bow"]
        functions = {function.__name__: function for function in scene.avatar.direct_functions}
        assert set(functions) == set(schemas)
        call: Any = schemas["send_action"].handler
        await call(Params("send_action", {"action": "wave"}))
        await call(Params("send_action", {"action": "fly"}))
        await functions["send_action"](params=Params("send_action", {}), action="bow")

    play(script)
    (done, properties), (refused, loud), (direct, _) = answers
    assert (done["status"], properties.run_llm) == ("accepted", False)
    assert (refused["status"], loud) == ("rejected", None)
    assert "wave" in refused["reason"]
    assert direct["status"] == "accepted"


async def test_set_manner_is_a_direct_function_where_the_avatar_has_it() -> None:
    from pipecat.adapters.llm.schemas.direct_function import DirectFunctionWrapper
    from pipecat_echoavatar.tools import direct_functions

    asked: list[Any] = []

    class Backend:
        async def call(self, name: str, arguments: dict[str, Any], session: str) -> dict[str, str]:
            asked.append((name, arguments, session))
            return {"status": "done"}

    class Bridge:
        backend, ready = Backend(), SimpleNamespace(session="here")

    class Params:
        async def result_callback(self, result: Any, *, properties: Any) -> None:
            asked.append((result, properties.run_llm))

    toolbox = Toolbox(ActionLibrary({}), Tracks(), has_manner=True)
    functions = direct_functions(AvatarTools(Bridge(), toolbox.schemas()))  # type: ignore[arg-type]
    (function,) = [function for function in functions if function.__name__ == "set_manner"]
    schema = DirectFunctionWrapper(function).to_function_schema()
    assert set(schema.properties) == {"liveliness"}
    assert schema.required == ["liveliness"]
    assert "storyteller" in schema.properties["liveliness"]["description"]
    await function(params=Params(), liveliness=0.9)
    assert asked == [("set_manner", {"liveliness": 0.9}, "here"), ({"status": "done"}, False)]


def test_pipecat_understands_the_direct_functions() -> None:
    from pipecat.adapters.llm.schemas.direct_function import DirectFunctionWrapper

    async def script(scene: Scene) -> None:
        for function in scene.avatar.direct_functions:
            schema = DirectFunctionWrapper(function).to_function_schema()
            assert schema.description
            if schema.name == "send_action":
                assert schema.required == ["action"]
                assert "wave, bow" in schema.properties["action"]["description"]

    play(script)


def test_where_the_avatar_fails_the_voice_goes_on() -> None:
    async def script(scene: Scene) -> None:
        await scene.speak(1.0, stop=False)
        await scene.until(lambda: len(scene.transport.sound) > 4_000)
        assert scene.avatar.bridge._avatar is not None
        await scene.avatar.bridge._avatar.close()
        await scene.speak(1.0)
        await scene.until(lambda: len(scene.transport.sound) > 2 * 24_000 - 2_000)

    play(script)


def test_without_a_server_the_voice_goes_on() -> None:
    async def script(scene: Scene) -> None:
        await scene.speak(0.5)
        await scene.until(lambda: len(scene.transport.sound) > 11_000)

    transport = play(script, where="http://127.0.0.1:9")
    assert not transport.messages("motion")


@pytest.mark.slow
def test_the_default_bundle_speaks_dances_and_is_interrupted() -> None:
    async def script(scene: Scene) -> None:
        await scene.speak(3.0)
        await scene.until(lambda: len(scene.transport.sound) > 24_000, 30)
        await scene.push(InterruptionFrame())
        await scene.avatar.tool_calls.call("play_music", {})
        await scene.until(lambda: {m["state"] for m in scene.transport.messages("motion")} >= {"dancing"}, 30)
        await asyncio.sleep(2.0)

    transport = play(script, where="default")
    motion = transport.messages("motion")
    assert len({m["rotations"] for m in motion}) == len(motion)
    assert all(m["face"] for m in motion)
