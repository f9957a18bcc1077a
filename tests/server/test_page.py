from pathlib import Path

import pytest
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.testclient import TestClient

import echoavatar
from echoavatar.files.avatar import CHARACTERS
from echoavatar.server.page import SOUNDS, PageHeaders, page_routes

STATIC = Path(echoavatar.__file__).parent / "server/static"


@pytest.fixture(scope="module")
def client():
    return TestClient(Starlette(routes=page_routes(), middleware=[Middleware(PageHeaders)]))


def test_the_page_and_all_it_names_come_from_this_server(client):
    page = client.get("/")
    assert page.status_code == 200
    assert "default-src 'none'" in page.headers["content-security-policy"]
    for name in ("assets/index.js", "assets/index.css"):
        assert f"./{name}" in page.text
        assert client.get(f"/{name}").status_code == 200
    assert "http://" not in page.text
    assert "https://" not in page.text


def test_worklets_are_separate_scripts(client):
    for name in ("playback", "capture"):
        script = client.get(f"/assets/{name}.js")
        assert "javascript" in script.headers["content-type"]
        assert f"echoavatar-{name}" in script.text


@pytest.mark.parametrize("name", SOUNDS)
def test_sounds_are_served(client, name):
    assert client.get(f"/sounds/{name}").content[:4] == b"OggS"


def test_the_character_is_served_with_its_face(client):
    answer = client.get("/avatar.glb")
    assert answer.content[:4] == b"glTF"
    assert b'"jawOpen"' in answer.content


def test_each_character_is_served_packed_and_plain(client):
    """Who accepts gzip gets the page's largest file at under 1.4 MB; both ways hold the same bytes."""
    for name in CHARACTERS:
        with client.stream("GET", f"/avatar.glb?character={name}") as packed:
            assert packed.headers["content-encoding"] == "gzip"
            sent = sum(len(part) for part in packed.iter_raw())
            assert sent < 1_400_000
        plain = client.get(f"/avatar.glb?character={name}", headers={"accept-encoding": "identity"})
        assert "content-encoding" not in plain.headers
        assert len(plain.content) > sent
        assert plain.content[:4] == b"glTF"
    assert client.get("/avatar.glb?character=nobody").status_code == 404


def test_the_script_is_sent_packed(client):
    with client.stream("GET", "/assets/index.js") as answer:
        assert answer.headers["content-encoding"] == "gzip"
        assert sum(len(part) for part in answer.iter_raw()) < 300_000


def test_nothing_else_of_the_package_is_served(client):
    assert client.get("/sounds/character.npz").status_code == 404


def test_built_files_name_their_licences():
    assert "MIT" in (STATIC / "licences.txt").read_text("utf-8")
