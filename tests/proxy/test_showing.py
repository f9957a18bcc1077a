import base64

import numpy as np
from tests.proxy.test_added import motion

from echoavatar.proxy.decoder import Decoder
from echoavatar.proxy.hearing import Hearing
from echoavatar.proxy.showing import Showing
from echoavatar.proxy.voices import Voice
from echoavatar.wire import Flush, Latency, Limits, Ready, Rig, Sound

READY = Ready(
    version=1,
    server="",
    session="",
    resume="",
    resumed=False,
    at=0,
    epoch=0,
    seg=0,
    received=0,
    sample_rate=24_000,
    frame_rate=30,
    chunk_samples=6_400,
    rig=Rig(names=(), parents=(), rest=()),
    face=("a",),
    actions=(),
    tracks=(),
    latency=Latency(algorithm=0, compute=0),
    limits=Limits(),
)


def scene() -> tuple[Hearing, Showing, Voice]:
    hearing = Hearing()
    voice = Voice("item", "resp", 0, 0, Decoder(), begun=0.0, seg=1)
    hearing.voices.begin(voice)
    voice.add(np.full(6_400, 1_000, "<i2").tobytes())
    return hearing, Showing(hearing, READY, idle=True), voice


def kinds(hearing: Hearing, showing: Showing, sound: Sound, *, with_motion: bool = True) -> list[str]:
    events = list(showing.take(motion(sound.at))) if with_motion else []
    hearing.note(sound)
    return [event["type"] for event in [*events, *showing.take(sound)]]


def pcm(level: int) -> bytes:
    return np.full(6_400, level, "<i2").tobytes()


def test_motion_waits_for_the_sound_that_says_whose_it_is() -> None:
    hearing, showing, voice = scene()
    voice.end()
    made = kinds(hearing, showing, Sound(at=6_400, epoch=0, seg=1, pcm=pcm(1_001)))
    assert made == [
        "response.animation_blendshapes.delta",
        "echoavatar.animation_body.delta",
        "response.animation_blendshapes.done",
    ]


def test_a_slow_line_may_lose_motion_but_not_the_count() -> None:
    hearing, showing, voice = scene()
    voice.add(np.zeros(6_400, "<i2").tobytes())
    assert kinds(hearing, showing, Sound(at=6_400, epoch=0, seg=1, pcm=pcm(1_000)), with_motion=False) == []
    list(showing.take(motion(12_800)))
    hearing.note(Sound(at=12_800, epoch=0, seg=1, pcm=pcm(0)))
    events = list(showing.take(Sound(at=12_800, epoch=0, seg=1, pcm=pcm(0))))
    assert events[0]["frame_index"] == 8


def test_music_is_what_is_left_when_the_voice_is_taken_out() -> None:
    hearing, showing, _ = scene()
    sound = Sound(at=6_400, epoch=0, seg=1, pcm=pcm(1_300))
    hearing.note(sound)
    [music] = [event for event in showing.take(sound) if event["type"] == "echoavatar.music.delta"]
    assert set(np.frombuffer(base64.b64decode(music["delta"]), "<i2").tolist()) == {300}
    assert kinds(hearing, showing, Sound(at=12_800, epoch=0, seg=0, pcm=pcm(0))) == [
        "echoavatar.animation_body.delta"
    ]


def test_frames_that_were_taken_back_come_again_under_the_same_number() -> None:
    hearing, showing, voice = scene()
    sound = Sound(at=6_400, epoch=0, seg=1, pcm=pcm(1_000))
    kinds(hearing, showing, sound)
    [flush] = showing.take(Flush(at=6_400, epoch=1, seg=0, heard=0))
    assert (flush["type"], "item_id" in flush, voice.clock) == ("echoavatar.flush", False, [])
    assert kinds(hearing, showing, sound)[0] == "response.animation_blendshapes.delta"
    assert voice.clock == [6_400]
