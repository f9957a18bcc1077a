"""Fetching: hashes are checked, a damaged file is thrown away, and a machine without network is told so."""

import hashlib
from types import SimpleNamespace

import pytest

huggingface_hub = pytest.importorskip("huggingface_hub")
from huggingface_hub.errors import HFValidationError  # noqa: E402

from echoavatar.engine.pipeline import load_bundle  # noqa: E402
from echoavatar.errors import CheckpointError, EchoAvatarError  # noqa: E402
from echoavatar.hub import check, pull, push_to_hub  # noqa: E402


def hub(monkeypatch, info=None, error=None) -> list[dict]:
    """A hub with one model of one large and one small file, or one that raises."""
    calls = []

    def model_info(self, name, **options):
        if error is not None:
            raise error
        return info

    def snapshot_download(name, *, revision, local_dir, allow_patterns):
        calls.append({"name": name, "revision": revision, "only": allow_patterns})
        return str(local_dir)

    monkeypatch.setattr(huggingface_hub.HfApi, "model_info", model_info)
    monkeypatch.setattr(huggingface_hub, "snapshot_download", snapshot_download)
    return calls


def model(sha256: str) -> SimpleNamespace:
    large = SimpleNamespace(rfilename="ckpts/model.bin", lfs=SimpleNamespace(sha256=sha256))
    return SimpleNamespace(sha="c0ffee", siblings=[large, SimpleNamespace(rfilename="README.md", lfs=None)])


def test_what_came_is_checked_and_counted(tmp_path, monkeypatch):
    (tmp_path / "ckpts").mkdir()
    (tmp_path / "ckpts/model.bin").write_bytes(b"weights")
    calls = hub(monkeypatch, model(hashlib.sha256(b"weights").hexdigest()))
    done = pull("owner/name", tmp_path, only=["ckpts/*"])
    assert (done.files, done.checked, done.commit) == (1, 1, "c0ffee")
    assert calls == [{"name": "owner/name", "revision": "c0ffee", "only": ["ckpts/*"]}]


def test_a_file_with_another_hash_is_thrown_away(tmp_path, monkeypatch):
    (tmp_path / "ckpts").mkdir()
    (tmp_path / "ckpts/model.bin").write_bytes(b"something else")
    hub(monkeypatch, model(hashlib.sha256(b"weights").hexdigest()))
    with pytest.raises(CheckpointError, match=r"model\.bin has another sha256.*pull again"):
        pull("owner/name", tmp_path)
    assert not (tmp_path / "ckpts/model.bin").exists()
    check(tmp_path, {})


def test_without_network_it_says_what_to_do(tmp_path, monkeypatch):
    class ConnectError(Exception):
        """As httpx names it."""

    class TransportError(Exception):
        pass

    class RefusedError(ConnectError, TransportError):
        pass

    hub(monkeypatch, error=RefusedError("no route"))
    with pytest.raises(EchoAvatarError, match="cannot be reached.*run the same command again.*hf download owner/name"):
        pull("owner/name", tmp_path)
    hub(monkeypatch, error=HFValidationError("bad"))
    with pytest.raises(EchoAvatarError, match="write OWNER/NAME"):
        pull("not a name", tmp_path)
    hub(monkeypatch, error=ZeroDivisionError())
    with pytest.raises(ZeroDivisionError):
        pull("owner/name", tmp_path)


def test_a_bundle_is_loaded_by_its_name_on_the_hub(tiny_bundle, monkeypatch):
    """The second time, and without a network, from the cache."""
    calls = hub(monkeypatch, error=ConnectionError("no network"))
    cached = []

    def snapshot_download(name, **options):
        if options.get("local_files_only") and not cached:
            raise FileNotFoundError("not in the cache")
        return str(tiny_bundle)

    monkeypatch.setattr(huggingface_hub, "snapshot_download", snapshot_download)
    with pytest.raises(CheckpointError, match=r"not a folder, and as a name on the hub: .*cannot be reached"):
        load_bundle("owner/avatar")
    cached.append(True)
    assert load_bundle("owner/avatar").parameters > 0
    assert not calls


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
