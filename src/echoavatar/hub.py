"""Models from and to the hub, with the hub's own client, which resumes; downloads are checked against its hashes.

May import `errors`.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from echoavatar.errors import CheckpointError, DependencyError, EchoAvatarError

_BLOCK = 1 << 20
_CONNECTION = {  # error classes that mean "no connection" in requests, httpx, the hub's client and the system
    "ConnectionError",
    "LocalEntryNotFoundError",
    "NetworkError",
    "OfflineModeIsEnabled",
    "ProxyError",
    "Timeout",
    "TransportError",
    "gaierror",
}


class Pulled(NamedTuple):
    """The result of a pull."""

    folder: Path
    files: int
    checked: int
    commit: str


def pull(
    name: str, output: Path | None = None, *, revision: str | None = None, only: Sequence[str] | None = None
) -> Pulled:
    """Fetch a repository of the hub, or only the files that match `only`. Files already there are not fetched again.

    Raises:
        EchoAvatarError: there is no network or no such repository, or the repository needs a login.
        CheckpointError: the hash of a file differs from the published one.
    """
    with _in_words(name) as (api, snapshot_download):
        info = api.model_info(name, revision=revision, files_metadata=True)
        wanted = None if only is None else list(only)
        folder = snapshot_download(name, revision=info.sha, local_dir=output, allow_patterns=wanted)
    sums = {
        file.rfilename: file.lfs.sha256
        for file in info.siblings or []
        if file.lfs is not None and (Path(folder) / file.rfilename).exists()
    }
    check(Path(folder), sums)
    files = sum(1 for file in info.siblings or [] if (Path(folder) / file.rfilename).exists())
    return Pulled(Path(folder), files, len(sums), str(info.sha))


def push_to_hub(folder: Path, name: str, *, private: bool = False) -> str:
    """Publish a bundle's folder as OWNER/NAME with a model card, and return its address.

    Raises:
        CheckpointError: the folder is not a bundle.
        EchoAvatarError: there is no network, or nobody is logged in (`hf auth login`).
    """
    card = model_card(folder, name)
    with _in_words(name) as (api, _):
        api.create_repo(name, private=private, exist_ok=True)
        done = api.upload_folder(repo_id=name, folder_path=folder, ignore_patterns=["*.partial", "README.md"])
        api.upload_file(path_or_fileobj=card.encode(), path_in_repo="README.md", repo_id=name)
    return str(done.commit_url)


def model_card(folder: Path, name: str) -> str:
    """The hub's page of a bundle: its use, and what each part's card says of its data and licence.

    Raises:
        CheckpointError: the folder holds no part with a card.
    """
    cards = {path.parent.name: json.loads(path.read_text("utf-8")) for path in sorted(folder.glob("*/card.json"))}
    if not cards:
        raise CheckpointError(f"{folder} is not a bundle: no part of it has a card.json; see `echoavatar bundle`")
    licences = {str(card.get("licence", "unknown")) for card in cards.values()}
    licence = licences.pop().lower() if len(licences) == 1 else "other"
    rows = [f"| {part} | {_cell(card, 'data')} | {_cell(card, 'licence')} |" for part, card in cards.items()]
    return "\n".join(
        [
            "---",
            f"license: {licence if licence == 'apache-2.0' else 'other'}",
            "library_name: echoavatar",
            "tags: [audio-to-motion, co-speech-gesture, dance, avatar, streaming]",
            "---",
            f"# {name}",
            "",
            "An EchoAvatar bundle: sound becomes full-body motion, in real time.",
            "",
            "```python",
            "import echoavatar",
            "",
            f'animation = echoavatar.animate("talk.wav", model="{name}")',
            'animation.save("talk.glb")',
            "```",
            "",
            "| part | trained on | licence |",
            "|---|---|---|",
            *rows,
            "",
        ]
    )


def _cell(card: Mapping[str, object], key: str) -> str:
    return " ".join(str(card.get(key, "not said")).split()).replace("|", "\\|")


@contextmanager
def _in_words(name: str) -> Iterator[tuple[Any, Any]]:
    """The hub's client and its `snapshot_download`; their errors become one sentence each."""
    try:
        from huggingface_hub import HfApi, snapshot_download
        from huggingface_hub.errors import GatedRepoError, HfHubHTTPError, HFValidationError, RepositoryNotFoundError
    except ImportError as error:
        raise DependencyError("the hub needs huggingface_hub: pip install 'echoavatar[hub]'") from error
    try:
        yield HfApi(), snapshot_download
    except HFValidationError as error:
        raise EchoAvatarError(f"{name!r} is not a name on the hub; write OWNER/NAME ({error})") from error
    except GatedRepoError as error:
        raise EchoAvatarError(f"{name} is gated: accept its terms on its page, then run `hf auth login`") from error
    except RepositoryNotFoundError as error:
        raise EchoAvatarError(
            f"the hub has no public {name}; check the name, or run `hf auth login` if it is private"
        ) from error
    except HfHubHTTPError as error:
        raise EchoAvatarError(f"the hub refused {name}: {error}; log in with `hf auth login` or try later") from error
    except EchoAvatarError:
        raise
    except Exception as error:  # the client's transport raises different classes in different versions
        if not _is_connection(error):
            raise
        raise EchoAvatarError(
            f"the hub cannot be reached ({type(error).__name__}); fetched files are kept: run the same command again "
            f"with a network, or fetch {name} elsewhere with `hf download {name}` and copy the folder"
        ) from error


def fetch(name: str) -> Path:
    """The folder of a model: from the hub's cache, or else fetched by `pull`."""
    try:
        from huggingface_hub import snapshot_download

        return Path(snapshot_download(name, local_files_only=True))
    except (ImportError, OSError, ValueError):  # the client's "not in the cache" is one of these; `pull` explains
        return pull(name).folder


def check(folder: Path, sums: Mapping[str, str]) -> None:
    """Compare files with their SHA-256 hashes.

    Raises:
        CheckpointError: one differs. It is removed, so that the next pull fetches it again.
    """
    for name, wanted in sums.items():
        path = folder / name
        digest = hashlib.sha256()
        with path.open("rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
        if digest.hexdigest() != wanted:
            path.unlink()
            raise CheckpointError(
                f"{path} has another sha256 than published ({digest.hexdigest()[:12]}..., wanted {wanted[:12]}...);"
                " it was removed; pull again"
            )


def _is_connection(error: BaseException | None) -> bool:
    """Whether the connection failed, whichever library raised the error."""
    while error is not None:
        if _CONNECTION & {kind.__name__ for kind in type(error).__mro__}:
            return True
        error = error.__cause__ or error.__context__
    return False
