"""Pages and what all of them share."""

import json

from starlette.applications import Starlette
from starlette.testclient import TestClient

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_studio.page import page_routes, scene


def test_the_scene_is_our_rig():
    assert scene().rig.names == tuple(HUMANOID.names)
    assert scene().face == tuple(ARKIT_NAMES)
    assert len(scene().rig.rest) == HUMANOID.joints


def test_words_are_the_owners_else_ours_else_there_are_none(tmp_path, caplog):
    own = tmp_path / "words"
    http = TestClient(Starlette(routes=page_routes(words=own)))
    english = http.get("/words/en.json").json()
    assert english["saved"] == "Saved"
    assert http.get("/words/de.json").json()["code"] == "not_found"
    own.mkdir()
    (own / "de.json").write_text(json.dumps({"saved": "Gespeichert"}))
    assert http.get("/words/de.json").json() == {"saved": "Gespeichert"}
    for text in ('{"saved": 1}', "no words", '["saved"]'):
        (own / "fr.json").write_text(text)
        assert http.get("/words/fr.json").status_code == 404
        assert "fr.json holds no words" in caplog.text
    (tmp_path / "xx.json").write_text("{}")
    for name in ("../xx", "%2e%2e%2fxx", "german", ""):
        assert http.get(f"/words/{name}.json").status_code == 404


def test_pages_come_from_this_server_only(tmp_path):
    (tmp_path / "assets").mkdir()
    (tmp_path / "rate.html").write_text("<p>rate")
    (tmp_path / "assets" / "rate.js").write_text("1")
    http = TestClient(Starlette(routes=page_routes(tmp_path)))
    page = http.get("/rate")
    assert page.text == "<p>rate"
    assert "default-src 'none'" in page.headers["content-security-policy"]
    assert "frame-ancestors 'none'" in page.headers["content-security-policy"]
    assert page.headers["referrer-policy"] == "no-referrer"
    assert http.get("/assets/rate.js").text == "1"
    assert "not built" in http.get("/").text
    assert http.get("/avatar.glb").content[:4] == b"glTF"
    assert http.get("/api/scene").json()["frame_rate"] == 30
