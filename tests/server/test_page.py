import json
import re
import shutil
import subprocess
from itertools import product
from pathlib import Path
from urllib.parse import urljoin

import pytest
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.testclient import TestClient
from tests.web.ktx2 import make_ktx2

import echoavatar
from echoavatar.files.avatar import CHARACTERS
from echoavatar.server.page import SOUNDS, PageHeaders, page_routes

STATIC = Path(echoavatar.__file__).parent / "server/static"


def asset(name, suffix):
    """The path of a built file; its name holds a hash."""
    (path,) = STATIC.glob(f"assets/{name}-*.{suffix}")
    return path.relative_to(STATIC).as_posix()


@pytest.fixture(scope="module")
def client():
    return TestClient(Starlette(routes=page_routes(), middleware=[Middleware(PageHeaders)]))


def test_the_page_and_all_it_names_come_from_this_server(client):
    page = client.get("/")
    assert page.status_code == 200
    assert "default-src 'none'" in page.headers["content-security-policy"]
    for suffix in ("js", "css"):
        built = client.get(asset("index", suffix))
        assert f'"./{asset("index", suffix)}"' in page.text
        assert "immutable" in built.headers["cache-control"]
    assert "http://" not in page.text
    assert "https://" not in page.text


def test_one_script_may_evaluate_code_and_reaches_nothing(client):
    policies = {name: client.get(name).headers["content-security-policy"] for name in _scripts()}
    evaluating = {name for name, policy in policies.items() if "'unsafe-eval'" in policy}
    assert evaluating == {asset("transcode", "js")}
    assert "connect-src 'none'" in policies[asset("transcode", "js")]


def _scripts():
    return [path.relative_to(STATIC).as_posix() for path in STATIC.glob("assets/*.js")]


UNPACK = """
import { readFileSync } from "node:fs";
const [script, ...files] = process.argv.slice(2), { exit } = process, { log } = console;
const data = files.map((path) => new Uint8Array(readFileSync(path)).buffer);
const location = { href: "https://a/" };
Object.assign(globalThis, { self: globalThis, importScripts() {}, location, process: undefined });
self.postMessage = ({ pixels, width, height, fault }) => {
  log(JSON.stringify([width, height, fault, ...pixels.slice(0, 4)]));
  exit(0);
};
await import(script);
for (const part of data) await self.onmessage({ data: part });
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node")
def test_the_page_unpacks_ktx2_textures(tmp_path):
    """Its worker with its transcoder, as a browser starts them (which `tests/web` does); the page names both."""
    for name, content in (("run.mjs", UNPACK.encode()), ("a.ktx2", make_ktx2((220, 30, 60, 255)))):
        (tmp_path / name).write_bytes(content)
    worker = shutil.copy(STATIC / asset("transcode", "js"), tmp_path / "worker.mjs")
    words = ["node", tmp_path / "run.mjs", worker, STATIC / asset("basis_transcoder", "wasm"), tmp_path / "a.ktx2"]
    assert json.loads(subprocess.check_output(words, timeout=60)) == [8, 8, "", 220, 30, 60, 255]
    scripts = "".join((STATIC / name).read_text("utf-8") for name in _scripts())
    for name in (asset("transcode", "js"), asset("basis_transcoder", "wasm")):
        assert name.removeprefix("assets/") in scripts


def test_worklets_are_separate_scripts(client):
    for name in ("playback", "capture"):
        script = client.get(asset(name, "js"))
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
    """Each level is small; the whole file, for other programs, is large. Packed and plain hold the same."""
    for name, (level, most) in product(CHARACTERS, (("", 1_800_000), ("&level=0", 900_000), ("&level=2", 290_000))):
        address = f"/avatar.glb?character={name}{level}"
        with client.stream("GET", address) as packed:
            assert packed.headers["content-encoding"] == "gzip"
            sent = sum(len(part) for part in packed.iter_raw())
            assert sent < most
        plain = client.get(address, headers={"accept-encoding": "identity"})
        assert "content-encoding" not in plain.headers
        assert len(plain.content) > sent
        assert plain.content[:4] == b"glTF"
        again = client.get(address, headers={"if-none-match": plain.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")
    for wrong in ("character=nobody", "level=3", "level=x"):
        assert client.get(f"/avatar.glb?{wrong}").status_code == 404


def test_the_page_asks_early_for_the_avatar_that_its_address_names(client):
    def hurried(query):
        return re.findall(r'rel="preload" href="\./([^"]+)"', client.get(f"/{query}").text)

    assert hurried("") == hurried('?character="><script>') == ["avatar.glb?level=2"]
    assert hurried("?character=theo") == ["avatar.glb?character=theo&amp;level=2"]


def test_page_and_avatar_are_small(client):
    """What a visit sends at most: 1.5 MB, of which the first picture needs less than half a one."""

    def sent(path):
        with client.stream("GET", path) as answer:
            return sum(len(part) for part in answer.iter_raw())

    page = sum(sent(path) for path in ("/", "assets/three.js", asset("index", "js"), asset("index", "css")))
    coarsest, finest = (max(sent(f"/avatar.glb?character={name}&level={n}") for name in CHARACTERS) for n in (2, 0))
    assert page + coarsest < 550_000
    assert page + coarsest + finest < 1_500_000


@pytest.mark.parametrize(("path", "most"), [("assets/three.js", 220_000), (asset("index", "js"), 80_000)])
def test_scripts_are_sent_packed(client, path, most):
    with client.stream("GET", path) as answer:
        assert answer.headers["content-encoding"] == "gzip"
        assert sum(len(part) for part in answer.iter_raw()) < most


def test_nothing_else_of_the_package_is_served(client):
    assert client.get("/sounds/character.npz").status_code == 404


CLIENT = ("client/echo-avatar.js", "client/index.js", "client/three.js", "client/worklets/playback.js")


def test_pages_of_other_sites_load_code_and_characters_and_nothing_else(client):
    open_to_all = "access-control-allow-origin"
    shared = ("assets/three.js", "avatar.glb", "avatar.glb?character=nobody", "sounds/speech.ogg", *CLIENT)
    assert {client.get(name).headers.get(open_to_all) for name in shared} == {"*"}
    assert open_to_all not in client.get("/").headers


def test_one_tag_loads_little(client):
    """Scripts and the coarsest character, packed; the scripts import each other and three.js, and no other site's."""

    def visited(path, seen):
        with client.stream("GET", path) as answer:
            seen[path] = sum(len(part) for part in answer.iter_raw())
        for name in re.findall(r'(?:from|import)\s*"([./][^"]+)"', client.get(path).text):
            there = urljoin(f"http://x/{path}", name).removeprefix("http://x/")
            if there not in seen:
                visited(there, seen)
        return seen

    seen = visited("client/echo-avatar.js", {})
    three = [path for path in seen if path.startswith("assets/three.js?v=")]
    assert len(three) == 1
    own = sum(seen.values()) - seen[three[0]]
    assert own < 60_000, seen
    assert sum(seen.values()) < 280_000, seen


def test_built_files_name_their_licences():
    assert "MIT" in (STATIC / "licences.txt").read_text("utf-8")
