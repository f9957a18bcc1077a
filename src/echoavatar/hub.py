"""Models from and to the Hugging Face hub. What the hub or a mirror states is checked.

The hub's own client publishes. This module downloads, because that client writes to any path that an answer names, and
reads more bytes than the hub stated. If one file name leads out of the folder, the whole repository is refused before
anything is written. A file ends at its stated size, must have its published hash, and resumes after an interruption.
Files lie where the hub's client keeps them, so that other programs share them. May import `outgoing` and below.
"""

import hashlib
import os
import re
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote, urljoin

from tqdm import tqdm

from echoavatar import outgoing
from echoavatar.cache import first_writable
from echoavatar.errors import CheckpointError, DependencyError, EchoAvatarError
from echoavatar.json_reader import read_object, read_object_file
from echoavatar.limits import CONFIG_BYTES
from echoavatar.outgoing import OutgoingError, is_private, origin
from echoavatar.whole_file import write_whole

MOST_BYTES = 1 << 37  # of one pull
MOST_FILES = 10_000
SLOWEST = 1 << 15  # bytes a second of a download
PATIENCE_S = 60.0  # of a download, beside the time of its bytes at `SLOWEST`
MOST_REDIRECTS = 5
TRIES = 4  # in a row that may fail without a new byte
PAUSE_S = 1.0
_BLOCK = 1 << 20
_SHA256 = 64  # hexadecimal digits of a SHA-256
_COMMIT = re.compile(r"[0-9A-Za-z]{1,64}")
_DIGEST = re.compile(r"[0-9a-f]{40}|[0-9a-f]{64}")


class Pulled(NamedTuple):
    """The result of a pull."""

    folder: Path
    files: int
    checked: int  # files with a SHA-256, which the large ones have; small ones have Git's hash
    commit: str


class _File(NamedTuple):
    """A file as the hub states it."""

    name: str
    size: int
    digest: str  # SHA-256, or Git's SHA-1 of small files; empty where the hub states none


def pull(
    name: str, output: Path | None = None, *, revision: str | None = None, only: Sequence[str] | None = None
) -> Pulled:
    """Fetch a repository of the hub, or only the files that match `only`. Files already there are not fetched again.

    A file that is there and damaged is removed and fetched again.

    Raises:
        EchoAvatarError: no network, no such repository, no login where one is needed, or no huggingface_hub.
        CheckpointError: the hub states invalid names or sizes, a file differs from them, or the disk is full.
    """
    hub, globs = _hub(name), [f"{each}*" if each.endswith("/") else each for each in only or ()]
    try:
        commit, stated = _stated(_described(hub, name, revision), name)
        files = [file for file in stated if only is None or any(fnmatch(file.name, glob) for glob in globs)]
        storage = Path(hub.constants.HF_HUB_CACHE) / f"models--{name.replace('/', '--')}"
        if output is None and hub.constants.HF_HUB_CACHE.startswith("~"):
            raise EchoAvatarError(f"{name}: this user has no home folder to keep it in; set HF_HOME, or give a folder")
        root = output or Path(hub.constants.HF_HUB_CACHE)  # the cache may share a file between repositories
        folder = output or storage / "snapshots" / commit
        places = {  # the path of every file, and of its bytes; in the cache the first is a link to the second
            file: (folder / file.name, storage / "blobs" / file.digest)
            if output is None and file.digest
            else (folder / file.name, folder / file.name)
            for file in files
        }
        for path, blob in places.values():
            for place in (path, blob, _partial(blob)):
                _check_inside(root, place)
        missing = [file for file, (path, blob) in places.items() if not _is_there(file, path, blob)]
        root.mkdir(parents=True, exist_ok=True)
        if (room := shutil.disk_usage(root).free) < (needed := sum(file.size for file in missing)):
            raise CheckpointError(f"{name} needs {needed:,} bytes, and {root} has {room:,}; free space")
        for file in missing:
            path, blob = places[file]
            _download(f"{hub.constants.ENDPOINT}/{name}/resolve/{commit}/{quote(file.name)}", _key(hub), file, blob)
            _link(path, blob)
        if output is None and only is None and commit != revision:
            reference = storage / "refs" / (revision or "main")
            _check_inside(storage / "refs", reference)
            reference.parent.mkdir(parents=True, exist_ok=True)
            write_whole(reference, commit)
    except OutgoingError as error:
        raise _in_words_of_http(error, name) from error
    except OSError as error:
        raise CheckpointError(
            f"cannot write {error.filename or name} ({error.strerror}); free space or choose another folder"
        ) from error
    return Pulled(folder, len(files), sum(len(file.digest) == _SHA256 for file in files), commit)


def fetch(name: str) -> Path:
    """The folder of a model: from the hub's cache, or else fetched by `pull`, whose errors it raises."""
    try:
        from huggingface_hub import constants, snapshot_download

        return Path(snapshot_download(name, local_files_only=True))
    except ImportError:
        return pull(name).folder  # its error says what to install
    except (OSError, ValueError):  # the client's "not in the cache" is one of these
        kept = Path(constants.HF_HUB_CACHE)
        place = first_writable(kept)
        return pull(name, None if place == kept else place / name).folder


def _hub(name: str) -> Any:
    """The hub's client. Raises EchoAvatarError: it is missing, `name` cannot be a repository, or the hub is off."""
    try:
        import huggingface_hub.constants
        from huggingface_hub.errors import HFValidationError
        from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]
    except ImportError as error:
        raise DependencyError("the hub needs huggingface_hub: pip install 'echoavatar[hub]'") from error
    try:
        validate_repo_id(name)
    except HFValidationError as error:
        raise EchoAvatarError(f"{name!r} is not a name on the hub; write OWNER/NAME ({error})") from error
    if huggingface_hub.constants.HF_HUB_OFFLINE:
        raise EchoAvatarError(f"{name}: the hub is switched off by HF_HUB_OFFLINE; unset it, or name a folder")
    return huggingface_hub


def _key(hub: Any) -> dict[str, str]:
    token = hub.get_token()
    return {"authorization": f"Bearer {token}"} if token else {}


def _described(hub: Any, name: str, revision: str | None) -> dict[str, Any]:
    """What the hub says of a repository."""
    address = f"{hub.constants.ENDPOINT}/api/models/{name}"
    if revision is not None:
        address += f"/revision/{quote(revision, safe='')}"
    answer = outgoing.fetch(f"{address}?blobs=true", headers=_key(hub), most=CONFIG_BYTES)
    return read_object(answer, f"the hub's description of {name}", error=CheckpointError)


def _stated(told: Mapping[str, Any], name: str) -> tuple[str, list[_File]]:
    """The commit and the files of a repository as the hub describes them.

    Raises:
        CheckpointError: a name leads out of the folder, a size or hash is invalid, or it is more than a pull takes.
    """
    commit, siblings = told.get("sha"), told.get("siblings")
    if not isinstance(commit, str) or not _COMMIT.fullmatch(commit):
        raise CheckpointError(f"{name} is refused: the hub states the commit {str(commit)[:80]!r}")
    if not isinstance(siblings, list) or len(siblings) > MOST_FILES:
        raise CheckpointError(f"{name} is refused: the hub states no list of at most {MOST_FILES:,} files")
    files = [_file(sibling, name) for sibling in siblings]
    if len({file.name for file in files}) < len(files):
        raise CheckpointError(f"{name} is refused: the hub states a file twice")
    if sum(file.size for file in files) > MOST_BYTES:
        raise CheckpointError(f"{name} is refused: its files have more than {MOST_BYTES:,} bytes")
    return commit, files


def _file(told: Any, name: str) -> _File:
    large = told.get("lfs") if isinstance(told, dict) else None
    if not isinstance(told, dict) or not isinstance(large, dict | None):
        raise CheckpointError(f"{name} is refused: the hub states a file as {str(told)[:80]!r}")
    path, size = told.get("rfilename"), told.get("size")
    digest = large.get("sha256") if large else told.get("blobId") or ""
    if not isinstance(path, str) or not _stays_inside(path):
        raise CheckpointError(f"{name} is refused: its file {str(path)[:80]!r} leads out of the folder")
    if type(size) is not int or size < 0 or (large and large.get("size", size) != size):
        raise CheckpointError(f"{name} is refused: the hub states the size {str(size)[:80]!r} of {path!r}")
    if not isinstance(digest, str) or (not _DIGEST.fullmatch(digest) and (digest or large)):
        raise CheckpointError(f"{name} is refused: the hub states the hash {str(digest)[:80]!r} of {path!r}")
    return _File(path, size, digest)


def _stays_inside(name: str) -> bool:
    """Whether a relative path stays in its folder on every system, and out of a Git repository there."""
    parts = name.lower().split("/")
    return name.isprintable() and not set("\\:") & set(name) and not {"", ".", "..", ".git"} & set(parts)


def _check_inside(root: Path, path: Path) -> None:
    """Raises CheckpointError if links lead a path out of its folder."""
    try:
        is_inside = path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError, ValueError):  # a circle of links
        is_inside = False
    if not is_inside:
        raise CheckpointError(f"{path} leads out of {root}; remove the link, or choose another folder")


def _is_there(file: _File, path: Path, blob: Path) -> bool:
    """Whether a file is there and whole. A damaged file in its place is removed, together with what it links to."""
    if _is_whole(file, path):
        return True
    for place in (path, blob):
        if place.is_file() and not _is_whole(file, place):
            place.resolve().unlink()
        if not place.exists():
            place.unlink(missing_ok=True)  # a link to nothing
    return False


def _is_whole(file: _File, path: Path) -> bool:
    if not path.is_file() or path.stat().st_size != file.size:
        return False
    if not file.digest:
        return True
    digest = hashlib.sha256() if len(file.digest) == _SHA256 else hashlib.sha1(b"blob %d\0" % file.size)
    with path.open("rb") as opened_file:
        while block := opened_file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest() == file.digest


def _partial(path: Path) -> Path:
    return path.with_name(f"{path.name}.partial")


def _download(address: str, key: Mapping[str, str], file: _File, path: Path) -> None:
    """Fetch the rest of a file, from where an earlier attempt ended; a file with another hash is removed.

    Raises:
        OutgoingError: the hub refuses it or stops answering; the bytes that came are kept.
        CheckpointError: it is longer or shorter than stated, or has another hash.
    """
    if path.is_file():  # a file with the same bytes was fetched before
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    part = _partial(path)
    part.touch()
    end, tries = time.monotonic() + PATIENCE_S + file.size / SLOWEST, 0
    while (had := part.stat().st_size) < file.size:
        try:
            _append(address, key, file, part, end - time.monotonic())
            break
        except OutgoingError as error:
            if error.status == 416:
                part.write_bytes(b"")  # the bytes there are of another file
            tries = 0 if part.stat().st_size > had else tries + 1
            if error.status not in (0, 416, 429, 500, 502, 503, 504) or tries == TRIES or time.monotonic() > end:
                raise
            time.sleep(PAUSE_S)
    if not _is_whole(file, part):
        part.unlink()
        raise CheckpointError(f"{path} has another size or sha256 than published; it was removed; pull again")
    part.replace(path)


def _append(address: str, key: Mapping[str, str], file: _File, part: Path, seconds: float) -> None:
    """Append the missing bytes to a partial file; stops at the first byte beyond the stated size."""
    had = part.stat().st_size
    headers = {**key, "range": f"bytes={had}-"} if had else key
    with _answer(address, headers, seconds) as answer, part.open("ab") as target:
        if answer.status != 206:
            target.truncate(0)
            had = 0
        with tqdm(total=file.size, initial=had, desc=file.name, unit="B", unit_scale=True, disable=None) as bar:
            for block in answer.blocks():
                target.write(block[: file.size + 1 - had])
                had += len(block)
                bar.update(len(block))
                if had > file.size:
                    return


def _answer(address: str, headers: Mapping[str, str], seconds: float, hops: int = MOST_REDIRECTS) -> outgoing.Answer:
    """The hub's answer. It may redirect to a storage server for large files, which is asked without the key.

    Raises:
        OutgoingError: the hub refuses, or redirects to another scheme or into a private network.
    """
    try:
        return outgoing.opened(address, headers=headers, seconds=seconds)
    except OutgoingError as error:
        if error.status not in (301, 302, 303, 307, 308) or not hops:
            raise
        there = urljoin(address, str(error.headers.get("location", "")))
        (scheme, host, _), (new_scheme, new_host, _) = origin(address), origin(there)
        if new_scheme != scheme or (is_private(new_host) and not is_private(host)):
            raise
    return _answer(there, {name: value for name, value in headers.items() if name == "range"}, seconds, hops - 1)


def _link(path: Path, blob: Path) -> None:
    """Make a file of the cache a link to its bytes, or a copy of them where the system has no links."""
    if path == blob:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        path.symlink_to(os.path.relpath(blob, path.parent))
    except OSError:
        shutil.copyfile(blob, path)


def _in_words_of_http(error: OutgoingError, name: str) -> EchoAvatarError:
    """An error of the hub as one sentence with a remedy."""
    code = str(error.headers.get("x-error-code", ""))
    if code == "GatedRepo" or (error.status == 403 and not code):
        return EchoAvatarError(f"{name} is gated: accept its terms on its page, then run `hf auth login`")
    if code == "RevisionNotFound":
        return EchoAvatarError(f"{name} has no such revision; give a branch, a tag or a commit")
    if code == "RepoNotFound" or error.status in (401, 404):
        return EchoAvatarError(f"the hub has no public {name}; check the name, or run `hf auth login` if it is private")
    if error.status:
        return EchoAvatarError(f"the hub refused {name}: {error}; try later")
    return EchoAvatarError(
        f"the hub cannot be reached ({error}); fetched files are kept: run the same command again with a network, or "
        f"fetch {name} elsewhere with `hf download {name}` and copy the folder"
    )


def push_to_hub(folder: Path, name: str, *, private: bool = False) -> str:
    """Publish a bundle's folder as OWNER/NAME with a model card, and return its address.

    Raises:
        CheckpointError: the folder is not a bundle.
        EchoAvatarError: there is no network, or nobody is logged in (`hf auth login`).
    """
    card = model_card(folder, name)
    with _in_words(name) as api:
        api.create_repo(name, private=private, exist_ok=True)
        done = api.upload_folder(repo_id=name, folder_path=folder, ignore_patterns=["*.partial", "README.md"])
        api.upload_file(path_or_fileobj=card.encode(), path_in_repo="README.md", repo_id=name)
    return str(done.commit_url)


_CARD = """---
license: {licence}
library_name: echoavatar
tags: [audio-to-motion, co-speech-gesture, dance, avatar, streaming]
---
# {name}

An EchoAvatar bundle: sound becomes full-body motion, in real time.

```python
import echoavatar

animation = echoavatar.animate("talk.wav", model="{name}")
animation.save("talk.glb")
```

| part | trained on | licence |
|---|---|---|
{rows}
"""


def model_card(folder: Path, name: str) -> str:
    """The hub's page of a bundle: its use, and what each part's card says of its data and licence.

    Raises:
        CheckpointError: the folder holds no part with a card.
    """
    cards = {path.parent.name: read_object_file(path) for path in sorted(folder.glob("*/card.json"))}
    if not cards:
        raise CheckpointError(f"{folder} is not a bundle: no part of it has a card.json; see `echoavatar bundle`")
    licences = {str(card.get("licence", "unknown")) for card in cards.values()}
    licence = licences.pop().lower() if len(licences) == 1 else "other"
    rows = [f"| {part} | {_cell(card, 'data')} | {_cell(card, 'licence')} |" for part, card in cards.items()]
    return _CARD.format(name=name, rows="\n".join(rows), licence=licence if licence == "apache-2.0" else "other")


def _cell(card: Mapping[str, object], key: str) -> str:
    return " ".join(str(card.get(key, "not said")).split()).replace("|", "\\|")


@contextmanager
def _in_words(name: str) -> Iterator[Any]:
    """The hub's client; its errors become one sentence each."""
    hub = _hub(name)
    from huggingface_hub.errors import HfHubHTTPError, HTTPError  # type: ignore[attr-defined]

    try:
        yield hub.HfApi()
    except HfHubHTTPError as error:
        raise EchoAvatarError(f"the hub refused {name}: {error}; log in with `hf auth login` or try later") from error
    except (OSError, HTTPError) as error:
        raise EchoAvatarError(f"the hub cannot be reached ({type(error).__name__}); try later") from error
