"""Fetch a model from the hub with the hub's own client, which resumes, and check it against the published hashes."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

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
    """What was fetched."""

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
    try:
        from huggingface_hub import HfApi, snapshot_download
        from huggingface_hub.errors import GatedRepoError, HfHubHTTPError, HFValidationError, RepositoryNotFoundError
    except ImportError as error:
        raise DependencyError("pull needs huggingface_hub: pip install 'echoavatar[hub]'") from error
    try:
        info = HfApi().model_info(name, revision=revision, files_metadata=True)
        wanted = None if only is None else list(only)
        folder = snapshot_download(name, revision=info.sha, local_dir=output, allow_patterns=wanted)
    except HFValidationError as error:
        raise EchoAvatarError(f"{name!r} is not a name on the hub; write OWNER/NAME ({error})") from error
    except GatedRepoError as error:
        raise EchoAvatarError(f"{name} is gated: accept its terms on its page, then run `hf auth login`") from error
    except RepositoryNotFoundError as error:
        raise EchoAvatarError(
            f"the hub has no public {name}; check the name, or run `hf auth login` if it is private"
        ) from error
    except HfHubHTTPError as error:
        raise EchoAvatarError(f"the hub refused {name}: {error}; try again later") from error
    except Exception as error:  # the client's transport raises different classes in different versions
        if not _is_connection(error):
            raise
        raise EchoAvatarError(
            f"the hub cannot be reached ({type(error).__name__}); fetched files are kept: run the same command again "
            f"with a network, or fetch {name} elsewhere with `hf download {name}` and copy the folder"
        ) from error
    sums = {
        file.rfilename: file.lfs.sha256
        for file in info.siblings or []
        if file.lfs is not None and (Path(folder) / file.rfilename).exists()
    }
    check(Path(folder), sums)
    files = sum(1 for file in info.siblings or [] if (Path(folder) / file.rfilename).exists())
    return Pulled(Path(folder), files, len(sums), str(info.sha))


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
