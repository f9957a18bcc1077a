import json

import numpy as np

from echoavatar.agents.proxy import avatar_events
from echoavatar.agents.proxy.decoder import Decoder
from echoavatar.agents.proxy.speech_items import SpeechItem
from echoavatar.wire import Flush, Pose, pack_pose


def motion(at: int = 6_400):
    turned = np.zeros((8, 52, 4), np.float32)
    turned[..., 0] = 1
    return pack_pose(Pose(turned, np.zeros((8, 3), np.float32), np.full((8, 52), 0.5, np.float32)), at=at)


VOICE = SpeechItem("item_1", "resp_1", 2, 1, Decoder(), begun=0.0)


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
