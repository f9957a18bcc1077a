import json

import numpy as np
from tests.server.sinks.receiving import RIG, random_frame

from echoavatar.server.sinks.json_udp import JsonEncoder


def test_the_rig_comes_first_and_every_second_and_poses_fit_it() -> None:
    encoder, frame = JsonEncoder(RIG), random_frame()
    rig, pose = (json.loads(packet) for packet in encoder(frame._replace(seconds=0.0)))
    assert (rig["type"], pose["type"]) == ("rig", "pose")
    assert len(rig["names"]) == len(rig["parents"]) == len(rig["rest"]) == len(pose["rotations"])
    assert len(rig["face"]) == len(pose["face"])
    wxyz = np.roll(pose["rotations"], 1, axis=-1)
    np.testing.assert_allclose(wxyz, frame.rotations, atol=1e-5)
    np.testing.assert_allclose(pose["root"], frame.root, atol=1e-5)
    assert pose["clock"] == 0.2
    counts = [len(list(encoder(frame._replace(seconds=t)))) for t in (0.5, 0.99, 1.0, 1.5)]
    assert counts == [1, 1, 2, 1]


def test_a_datagram_holds_a_frame() -> None:
    assert max(len(packet) for packet in JsonEncoder(RIG)(random_frame())) < 8_000


def test_no_face_is_null() -> None:
    *_, pose = JsonEncoder(RIG)(random_frame(has_face=False))
    assert json.loads(pose)["face"] is None
