"""Fetching: hashes are checked, a damaged file is thrown away, and a machine without network is told so."""

import hashlib
from types import SimpleNamespace

import pytest

huggingface_hub = pytest.importorskip("huggingface_hub")
from huggingface_hub.errors import HFValidationError  # noqa: E402

from echoavatar.errors import CheckpointError, EchoAvatarError  # noqa: E402
from echoavatar_research.reference.pull import check, pull  # noqa: E402


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
