import base64
import json

import msgspec
import numpy as np
from tests.agents.client.test_recording import READY

from echoavatar.agents.proxy import avatar_events
from echoavatar.agents.proxy.avatar_events import EventWriter
from echoavatar.agents.proxy.conversation import Conversation
from echoavatar.agents.proxy.speech_items import SpeechItem
from echoavatar.agents.voice_formats import Decoder
from echoavatar.wire.blobs import Pose, pack_pose
from echoavatar.wire.messages import Flush, Sound

VOICE = SpeechItem("item_1", "resp_1", 2, 1, Decoder(), begun=0.0)
FACED = msgspec.structs.replace(READY, face=("a",))


def motion(at: int = 6_400):
    turned = np.zeros((8, 52, 4), np.float32)
    turned[..., 0] = 1
    return pack_pose(Pose(turned, np.zeros((8, 3), np.float32), np.full((8, 52), 0.5, np.float32)), at=at)


def test_the_face_has_the_address_that_azures_events_have() -> None:
    event = json.loads(avatar_events.encode(avatar_events.blendshapes(motion(), VOICE, 3)))
    assert event["event_id"].startswith("echoavatar_")
    assert list(event)[:2] == ["type", "event_id"]
    place = {"response_id": "resp_1", "item_id": "item_1", "output_index": 2, "content_index": 1}
    assert event.items() >= place.items()
    assert (event["frame_index"], np.shape(event["frames"])) == (24, (8, 52))
    assert event["frames"][0][0] == round(128 / 255, 3)


def test_idle_frames_have_no_address_and_bring_their_face() -> None:
    idle, spoken = avatar_events.body(motion(), None), avatar_events.body(motion(), VOICE)
    assert (idle["item_id"], idle["frame_index"], bool(idle["face"])) == (None, None, True)
    assert "face" not in spoken


def test_a_flush_names_the_item_that_it_cuts() -> None:
    told = Flush(at=800, epoch=2, seg=1, heard=0)
    assert avatar_events.flush(told, None) == {"type": "echoavatar.flush", "at": 800, "epoch": 2}
    assert avatar_events.flush(told, VOICE)["item_id"] == "item_1"


def scene() -> tuple[Conversation, EventWriter, SpeechItem]:
    conversation = Conversation()
    voice = SpeechItem("item", "resp", 0, 0, Decoder(), begun=0.0, seg=1)
    conversation.items.begin(voice)
    voice.add(np.full(6_400, 1_000, "<i2").tobytes())
    return conversation, EventWriter(conversation, FACED, idle=True), voice


def kinds(conversation: Conversation, writer: EventWriter, sound: Sound, *, with_motion: bool = True) -> list[str]:
    events = list(writer.events_for(motion(sound.at))) if with_motion else []
    conversation.on_avatar_sound(sound)
    return [event["type"] for event in [*events, *writer.events_for(sound)]]


def pcm(level: int) -> bytes:
    return np.full(6_400, level, "<i2").tobytes()


def test_motion_waits_for_the_sound_that_names_its_item() -> None:
    conversation, writer, voice = scene()
    voice.end()
    made = kinds(conversation, writer, Sound(at=6_400, epoch=0, seg=1, pcm=pcm(1_001)))
    assert made == [
        "response.animation_blendshapes.delta",
        "echoavatar.animation_body.delta",
        "response.animation_blendshapes.done",
    ]


def test_a_slow_connection_may_lose_motion_but_not_the_frame_count() -> None:
    conversation, writer, voice = scene()
    voice.add(np.zeros(6_400, "<i2").tobytes())
    assert kinds(conversation, writer, Sound(at=6_400, epoch=0, seg=1, pcm=pcm(1_000)), with_motion=False) == []
    list(writer.events_for(motion(12_800)))
    conversation.on_avatar_sound(Sound(at=12_800, epoch=0, seg=1, pcm=pcm(0)))
    events = list(writer.events_for(Sound(at=12_800, epoch=0, seg=1, pcm=pcm(0))))
    assert events[0]["frame_index"] == 8


def test_music_is_the_sound_minus_the_speech() -> None:
    conversation, writer, _ = scene()
    sound = Sound(at=6_400, epoch=0, seg=1, pcm=pcm(1_300))
    conversation.on_avatar_sound(sound)
    [music] = [event for event in writer.events_for(sound) if event["type"] == "echoavatar.music.delta"]
    assert set(np.frombuffer(base64.b64decode(music["delta"]), "<i2").tolist()) == {300}
    assert kinds(conversation, writer, Sound(at=12_800, epoch=0, seg=0, pcm=pcm(0))) == [
        "echoavatar.animation_body.delta"
    ]


def test_remade_frames_keep_their_numbers() -> None:
    conversation, writer, voice = scene()
    sound = Sound(at=6_400, epoch=0, seg=1, pcm=pcm(1_000))
    kinds(conversation, writer, sound)
    [flush] = writer.events_for(Flush(at=6_400, epoch=1, seg=0, heard=0))
    assert (flush["type"], "item_id" in flush, voice.clock) == ("echoavatar.flush", False, [])
    assert kinds(conversation, writer, sound)[0] == "response.animation_blendshapes.delta"
    assert voice.clock == [6_400]
