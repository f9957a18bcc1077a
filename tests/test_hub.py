"""Fetching from a mirror of the hub that may be hostile: nothing outside, nothing beyond what is stated, one line."""

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.hub_mirror import COMMIT, Mirror, hub_mirror

from echoavatar import hub as our_hub
from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.hub import fetch, pull, push_to_hub

huggingface_hub = pytest.importorskip("huggingface_hub")
pytest.importorskip("huggingface_hub.constants")

WEIGHTS = b"weights" * 1000
KEY = "hf_VerySecretKey123456"


@pytest.fixture
def mirror(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Mirror]:
    with hub_mirror() as mirror:
        constants = huggingface_hub.constants
        monkeypatch.setattr(constants, "ENDPOINT", mirror.url)
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
        monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
        monkeypatch.setattr(our_hub, "PAUSE_S", 0.01)
        monkeypatch.setenv("HF_TOKEN", KEY)
        yield mirror


def cached(tmp_path: Path) -> Path:
    return tmp_path / "cache/models--owner--name"


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_came_is_checked_counted_and_not_fetched_twice(mirror: Mirror, tmp_path: Path) -> None:
    mirror.add("ckpts/model.bin", WEIGHTS)
    mirror.add("README.md", b"# Name", is_large=False)
    mirror.add("empty.txt", b"", is_large=False)
    folder = tmp_path / "out"
    assert pull("owner/name", folder, only=["ckpts/"]) == (folder, 1, 1, COMMIT)
    assert everything(folder) == {"ckpts/model.bin": WEIGHTS}
    assert pull("owner/name", folder, revision="main") == (folder, 3, 1, COMMIT)
    assert everything(folder) == {"ckpts/model.bin": WEIGHTS, "README.md": b"# Name", "empty.txt": b""}
    assert mirror.downloads() == ["ckpts/model.bin", "README.md"]
    assert mirror.asked[0][2]["authorization"] == f"Bearer {KEY}"


def test_the_cache_is_that_of_the_hubs_own_client(mirror: Mirror, tmp_path: Path) -> None:
    mirror.add("a/model.bin", WEIGHTS)
    mirror.add("b/copy.bin", WEIGHTS)
    folder = pull("owner/name").folder
    assert mirror.downloads() == ["a/model.bin"], "one of two files with the same bytes"
    assert (folder / "b/copy.bin").read_bytes() == WEIGHTS
    assert huggingface_hub.snapshot_download("owner/name", local_files_only=True) == str(folder)
    assert fetch("owner/name") == folder
    assert huggingface_hub.try_to_load_from_cache("owner/name", "a/model.bin", cache_dir=tmp_path / "cache") == str(
        folder / "a/model.bin"
    )
    assert huggingface_hub.scan_cache_dir(tmp_path / "cache").size_on_disk >= len(WEIGHTS)


def test_part_of_a_repository_is_not_taken_for_the_whole(mirror: Mirror) -> None:
    mirror.add("model.bin", WEIGHTS)
    mirror.add("more.bin", b"more")
    pull("owner/name", only=["model.bin"])
    assert everything(fetch("owner/name")) == {"model.bin": WEIGHTS, "more.bin": b"more"}


@pytest.mark.parametrize("is_cached", [True, False])
def test_a_damaged_file_heals_at_the_next_pull(mirror: Mirror, tmp_path: Path, is_cached: bool) -> None:
    mirror.add("model.bin", WEIGHTS)
    output = None if is_cached else tmp_path / "out"
    path = pull("owner/name", output).folder / "model.bin"
    damaged = WEIGHTS[::-1]
    path.resolve().write_bytes(damaged)  # as long as before
    assert pull("owner/name", output).folder / "model.bin" == path
    assert path.read_bytes() == WEIGHTS
    assert mirror.downloads() == ["model.bin"] * 2
    path.resolve().write_bytes(damaged)
    mirror.by_name["model.bin"] = lambda handler: handler.answer(403, b"")
    with pytest.raises(EchoAvatarError):
        pull("owner/name", output)
    assert damaged not in everything(tmp_path).values(), "the bytes themselves are gone, not only the link to them"


def test_a_damaged_file_that_several_repositories_share_is_removed_itself(mirror: Mirror, tmp_path: Path) -> None:
    mirror.add("model.bin", WEIGHTS)
    blob = (pull("owner/name").folder / "model.bin").resolve()
    shared = tmp_path / "cache/shared"
    shared.write_bytes(b"damaged")
    blob.unlink()
    blob.symlink_to(shared)
    assert (pull("owner/name").folder / "model.bin").read_bytes() == WEIGHTS
    assert not shared.exists()


OUTSIDE = [
    "../escaped.txt", "a/../../escaped.txt", "/tmp/escaped-by-name.txt", "C:/escaped.txt", "C:escaped.txt",
    "..\\escaped.txt", "a\\..\\..\\escaped.txt", "\\\\host\\share\\x", "nul\0x", "a//b", "./a", "a/.", "", "line\nx",
    "a/..", ".git/hooks/post-commit", "x/.GIT/config", "stream:data", "\x1b[2Jx", "~\u202ex",
]  # fmt: skip


@pytest.mark.parametrize("name", OUTSIDE, ids=ascii)
@pytest.mark.parametrize("is_cached", [True, False])
def test_a_name_that_leads_out_refuses_the_repository_before_anything_is_touched(
    mirror: Mirror, tmp_path: Path, name: str, is_cached: bool
) -> None:
    victim = tmp_path / "escaped.txt"
    victim.write_bytes(b"mine")
    mirror.add("model.bin", WEIGHTS)
    mirror.add(name, b"theirs")
    with pytest.raises(CheckpointError, match="leads out of the folder"):
        pull("owner/name", None if is_cached else tmp_path / "out")
    assert everything(tmp_path) == {"escaped.txt": b"mine"}
    assert mirror.downloads() == []
    assert not Path("/tmp/escaped-by-name.txt").exists()


@pytest.mark.skipif(os.name != "posix", reason="links need rights on Windows")
@pytest.mark.parametrize("link", ["model.bin", "sub", "sub/model.bin", "model.bin.partial", "sub/circle"])
def test_a_link_that_leads_out_of_the_folder_is_not_followed(mirror: Mirror, tmp_path: Path, link: str) -> None:
    outside, folder = tmp_path / "outside", tmp_path / "out"
    (folder / link).parent.mkdir(parents=True)
    outside.mkdir()
    (outside / "model.bin").write_bytes(b"mine")
    target = {"sub": outside, "sub/circle": folder / "sub/circle"}.get(link, outside / "model.bin")
    (folder / link).symlink_to(target)
    mirror.add("other.bin", b"other")
    for name in ("model.bin", "sub/model.bin", "sub/circle/x"):
        mirror.add(name, WEIGHTS)
    with pytest.raises(CheckpointError, match="leads out of"):
        pull("owner/name", folder)
    assert everything(outside) == {"model.bin": b"mine"}
    assert mirror.downloads() == []


def test_a_link_in_the_cache_that_leads_out_is_not_followed(mirror: Mirror, tmp_path: Path) -> None:
    mirror.add("model.bin", WEIGHTS)
    path = pull("owner/name").folder / "model.bin"
    (tmp_path / "mine").write_bytes(b"mine")
    path.unlink()
    path.symlink_to(tmp_path / "mine")
    with pytest.raises(CheckpointError, match="leads out of"):
        pull("owner/name")
    assert (tmp_path / "mine").read_bytes() == b"mine"


def flood(handler: Any) -> None:
    handler.send_response(200)
    handler.end_headers()
    sent = 0
    try:
        while sent < 600 << 20:
            handler.wfile.write(b"x" * (1 << 16))
            sent += 1 << 16
    except OSError:
        pass
    handler.server.flooded = sent


@pytest.mark.parametrize("is_cached", [True, False])
def test_a_file_ends_at_its_stated_size(mirror: Mirror, tmp_path: Path, is_cached: bool) -> None:
    mirror.add("model.bin", b"x" * 100)
    mirror.by_name["model.bin"] = flood
    with pytest.raises(CheckpointError, match="another size or sha256"):
        pull("owner/name", None if is_cached else tmp_path / "out")
    deadline = time.monotonic() + 5
    while not hasattr(mirror, "flooded") and time.monotonic() < deadline:
        time.sleep(0.01)
    assert mirror.flooded < 32 << 20, "what fits in the buffers of two sockets"
    assert everything(tmp_path) == {}


def test_what_is_shorter_or_other_than_stated_is_thrown_away(mirror: Mirror, tmp_path: Path) -> None:
    for name, sent in (("short.bin", WEIGHTS[:-1]), ("other.bin", WEIGHTS[::-1])):
        mirror.told["siblings"].clear()
        mirror.add(name, WEIGHTS)
        mirror.sent[name] = sent
        with pytest.raises(CheckpointError, match=rf"{name} has another size or sha256.*pull again"):
            pull("owner/name", tmp_path / "out")
        assert everything(tmp_path) == {}


def test_an_interrupted_download_resumes(mirror: Mirror, tmp_path: Path) -> None:
    def hang_up(handler: Any) -> None:
        del mirror.by_name["model.bin"]
        handler.send_response(200)
        handler.send_header("content-length", str(len(WEIGHTS)))
        handler.end_headers()
        handler.wfile.write(WEIGHTS[:3000])

    mirror.add("model.bin", WEIGHTS)
    mirror.by_name["model.bin"] = hang_up
    pull("owner/name", tmp_path / "out")
    assert everything(tmp_path) == {"out/model.bin": WEIGHTS}
    assert [headers.get("range") for _, path, headers in mirror.asked if "resolve" in path] == [None, "bytes=3000-"]
    (tmp_path / "out/model.bin").rename(tmp_path / "out/model.bin.partial")  # as if it had been stopped at the end
    pull("owner/name", tmp_path / "out")
    assert len(mirror.downloads()) == 2
    for rest in (b"?" * 3000, WEIGHTS + b"!"):  # and what is no part of the file heals
        (tmp_path / "out/model.bin").unlink()
        (tmp_path / "out/model.bin.partial").write_bytes(rest)
        with pytest.raises(CheckpointError, match="pull again"):
            pull("owner/name", tmp_path / "out")
        pull("owner/name", tmp_path / "out")
        assert everything(tmp_path) == {"out/model.bin": WEIGHTS}


def test_a_mirror_that_drips_or_fails_for_ever_is_given_up(
    mirror: Mirror, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drip(handler: Any) -> None:
        handler.send_response(200)
        handler.send_header("content-length", str(len(WEIGHTS)))
        handler.end_headers()
        for letter in WEIGHTS:
            handler.wfile.write(bytes([letter]))
            time.sleep(0.02)

    mirror.add("model.bin", WEIGHTS)
    mirror.by_name["model.bin"] = drip
    monkeypatch.setattr(our_hub, "PATIENCE_S", 0.3)
    began = time.monotonic()
    with pytest.raises(EchoAvatarError, match=r"cannot be reached \(.*nothing whole within"):
        pull("owner/name", tmp_path / "out")
    assert time.monotonic() - began < 3
    mirror.by_name["model.bin"] = lambda handler: handler.answer(503, b"")
    with pytest.raises(EchoAvatarError, match="the hub refused owner/name: .*HTTP 503"):
        pull("owner/name", tmp_path / "out")


ODD = [
    b"", b"[]", b"null", b"{", b"[" * 5000, b'{"sha": NaN}', b'{"sha": "\\ud800", "siblings": []}',
    {"siblings": []}, {"sha": None, "siblings": []}, {"sha": "../..", "siblings": []}, {"sha": 7, "siblings": []},
    {"sha": COMMIT}, {"sha": COMMIT, "siblings": {}}, {"sha": COMMIT, "siblings": [None]},
    {"sha": COMMIT, "siblings": ["model.bin"]}, {"sha": COMMIT, "siblings": [{}]},
    {"sha": COMMIT, "siblings": [{"rfilename": ["a"], "size": 1}]},
    {"sha": COMMIT, "siblings": [{"rfilename": "a"}]},
    *({"sha": COMMIT, "siblings": [{"rfilename": "a", "size": size}]} for size in
      (None, -1, "1", 1.5, True, [], {}, 1 << 60)),
    *({"sha": COMMIT, "siblings": [{"rfilename": "a", "size": 1, "lfs": lfs}]} for lfs in
      ("x", 1, [1], {"size": 1}, {"sha256": None, "size": 1}, {"sha256": 7}, {"sha256": "../x"}, {"sha256": "A" * 64},
       {"sha256": "a" * 64, "size": 2}, {"sha256": "a" * 64, "size": []})),
    {"sha": COMMIT, "siblings": [{"rfilename": "a", "size": 1, "blobId": "../../x"}]},
    {"sha": COMMIT, "siblings": [{"rfilename": "a", "size": 1, "blobId": ["x"]}]},
    {"sha": COMMIT, "siblings": [{"rfilename": "a", "size": 1}, {"rfilename": "a", "size": 2}]},
    {"sha": COMMIT, "siblings": [{"rfilename": f"{k}", "size": 0} for k in range(10_001)]},
]  # fmt: skip


@pytest.mark.parametrize("told", ODD, ids=lambda told: str(told)[:60])
def test_an_odd_description_is_one_line(mirror: Mirror, tmp_path: Path, told: Any) -> None:
    mirror.told = told
    with pytest.raises(CheckpointError, match="is refused|the hub's description") as caught:
        pull("owner/name", tmp_path / "out")
    assert len(str(caught.value)) < 300
    assert everything(tmp_path) == {}
    assert mirror.downloads() == []


@pytest.mark.parametrize("names", [("a", "a/b"), ("a/b", "a"), ("x" * 255, "y"), ("d" * 300, "y")])
def test_files_that_cannot_be_written_are_one_line(mirror: Mirror, tmp_path: Path, names: tuple[str, str]) -> None:
    for name in names:
        mirror.add(name, b"x")
    with pytest.raises(CheckpointError):
        pull("owner/name", tmp_path / "out")


def test_a_folder_in_the_place_of_a_file_is_one_line(mirror: Mirror, tmp_path: Path) -> None:
    (tmp_path / "out/model.bin").mkdir(parents=True)
    mirror.add("model.bin", WEIGHTS)
    with pytest.raises(CheckpointError, match="cannot write"):
        pull("owner/name", tmp_path / "out")


def test_a_full_disk_is_found_before_it_is_full(
    mirror: Mirror, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mirror.add("model.bin", WEIGHTS)
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=6999))
    with pytest.raises(CheckpointError, match="needs 7,000 bytes.*has 6,999"):
        pull("owner/name", tmp_path / "out")
    assert mirror.downloads() == []


def test_an_endless_description_is_cut(mirror: Mirror, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(our_hub, "CONFIG_BYTES", 1000)
    mirror.told = {"sha": COMMIT, "siblings": [], "more": "x" * 2000}
    with pytest.raises(EchoAvatarError, match="sends more than 1,000 bytes"):
        pull("owner/name", tmp_path / "out")


def test_large_files_are_fetched_elsewhere_without_the_key(mirror: Mirror, tmp_path: Path) -> None:
    with hub_mirror() as other:
        other.sent["model.bin"] = WEIGHTS
        mirror.add("model.bin", WEIGHTS)
        there = f"{other.url}/x/resolve/{COMMIT}/model.bin"
        mirror.by_name["model.bin"] = lambda handler: handler.answer(302, b"", location=there)
        pull("owner/name", tmp_path / "out")
        assert everything(tmp_path) == {"out/model.bin": WEIGHTS}
        assert KEY not in json.dumps(other.asked)
        for place in ("file:///etc/passwd", "ftp://127.0.0.1/x", "http://[::1", "//", "https://127.0.0.1/x", "\x1b"):
            mirror.add("more.bin", b"x")
            mirror.by_name["more.bin"] = lambda handler, place=place: handler.answer(302, b"", location=place)
            with pytest.raises(EchoAvatarError):
                pull("owner/name", tmp_path / "out")
            mirror.told["siblings"].pop()


def test_a_redirect_from_the_hub_into_a_private_network_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def opened(address: str, **_: Any) -> None:
        asked.append(address)
        error = our_hub.OutgoingError("redirected", status=302)
        error.headers["location"] = "https://169.254.169.254/secrets"
        raise error

    monkeypatch.setattr(our_hub.outgoing, "opened", opened)
    monkeypatch.setattr(our_hub, "is_private", lambda host: host != "hub.example")
    with pytest.raises(our_hub.OutgoingError, match="redirected"):
        our_hub._answer("https://hub.example/x", {}, 1.0)
    assert asked == ["https://hub.example/x"]


@pytest.mark.parametrize(
    ("status", "code", "words"),
    [
        (401, "RepoNotFound", "has no public owner/name"),
        (404, "", "has no public owner/name"),
        (403, "GatedRepo", "owner/name is gated.*hf auth login"),
        (404, "RevisionNotFound", "no such revision"),
        (500, "", "refused owner/name: .*HTTP 500"),
    ],
)
def test_refusals_say_what_to_do(mirror: Mirror, tmp_path: Path, status: int, code: str, words: str) -> None:
    mirror.add("model.bin", WEIGHTS)
    mirror.by_name["model.bin"] = lambda handler: handler.answer(status, f"no {KEY}".encode(), x_error_code=code)
    with pytest.raises(EchoAvatarError, match=words) as caught:
        pull("owner/name", tmp_path / "out")
    assert KEY not in str(caught.value)


def test_without_network_it_says_what_to_do(mirror: Mirror, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(huggingface_hub.constants, "ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(EchoAvatarError, match="cannot be reached.*run the same command again.*hf download owner/name"):
        pull("owner/name", tmp_path)
    with pytest.raises(EchoAvatarError, match="write OWNER/NAME"):
        pull("not a name", tmp_path)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(EchoAvatarError, match="HF_HUB_OFFLINE"):
        pull("owner/name", tmp_path)


def test_a_bundle_is_loaded_by_its_name_on_the_hub(mirror: Mirror, tiny_bundle: Path) -> None:
    """The second time, and without a network, from the cache."""
    mirror.told["sha"] = None
    with pytest.raises(CheckpointError, match=r"not a folder, and as a name on the hub: .*commit"):
        load_bundle("owner/name")
    mirror.told["sha"] = COMMIT
    for path in tiny_bundle.rglob("*"):
        if path.is_file():
            mirror.add(path.relative_to(tiny_bundle).as_posix(), path.read_bytes())
    assert load_bundle("owner/name").parameters > 0
    asked = len(mirror.asked)
    assert load_bundle("owner/name").parameters > 0
    assert len(mirror.asked) == asked


def test_a_bundle_is_loaded_by_its_name_where_no_cache_can_be_written(
    mirror: Mirror, tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, content in everything(tiny_bundle).items():
        mirror.add(name, content)
    for place in ("/dev/null/cache", "~/.cache/huggingface/hub"):  # the second: a user without a home
        monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", place)
        assert everything(our_hub.fetch("owner/name")) == everything(tiny_bundle)
    with pytest.raises(EchoAvatarError, match="HF_HOME"):
        pull("owner/name")


def test_a_bundle_is_published_with_a_card(tiny_bundle, tmp_path, monkeypatch):
    sent = {}
    monkeypatch.setattr(huggingface_hub.HfApi, "create_repo", lambda self, name, **options: sent.update(options))
    monkeypatch.setattr(
        huggingface_hub.HfApi, "upload_folder", lambda self, **options: SimpleNamespace(commit_url="https://hub/commit")
    )
    monkeypatch.setattr(huggingface_hub.HfApi, "upload_file", lambda self, **options: sent.update(options))
    assert push_to_hub(tiny_bundle, "owner/avatar", private=True) == "https://hub/commit"
    assert sent["private"] is True
    card = sent["path_or_fileobj"].decode()
    assert card.startswith("---\nlicense: ")
    assert 'model="owner/avatar"' in card
    for part in ("codec", "tokenizer", "generator"):
        assert f"| {part} |" in card
    with pytest.raises(CheckpointError, match="not a bundle"):
        push_to_hub(tmp_path, "owner/avatar")
