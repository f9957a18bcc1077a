"""Models from the hub: fetched by its own client, which resumes, and checked against the hashes the hub publishes."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from ..errors import CheckpointError, DependencyError, EchoAvatarError

_BLOCK = 1 << 20
_CONNECTION = {  # names of errors that mean so, in requests, httpx, the hub's client and the system
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
    """What came."""

    folder: Path
    files: int
    checked: int
    commit: str


def pull(
    name: str, output: Path | None = None, *, revision: str | None = None, only: Sequence[str] | None = None
) -> Pulled:
    """Fetch a repository of the hub, or those of its files that match `only`; what is there is not fetched again.

    Raises:
        EchoAvatarError: no network, no such repository, or it asks for a login.
        CheckpointError: a file is not what the hub says it is.
    """
    try:
        from huggingface_hub import HfApi, snapshot_download
        from huggingface_hub.errors import (
            GatedRepoError,
            HfHubHTTPError,
            HFValidationError,
            RepositoryNotFoundError,
        )
    except ImportError as error:
        raise DependencyError("pull needs huggingface_hub: pip install huggingface_hub") from error
    try:
        info = HfApi().model_info(name, revision=revision, files_metadata=True)
        wanted = None if only is None else list(only)
        folder = snapshot_download(name, revision=info.sha, local_dir=output, allow_patterns=wanted)
    except HFValidationError as error:
        raise EchoAvatarError(f"{name!r} is no name on the hub: it is OWNER/NAME ({error})") from error
    except GatedRepoError as error:
        raise EchoAvatarError(
            f"{name} asks for its terms to be accepted: do so on its page, then `hf auth login`"
        ) from error
    except RepositoryNotFoundError as error:
        raise EchoAvatarError(
            f"the hub has no {name}, or only for those who log in (`hf auth login`)"
        ) from error
    except HfHubHTTPError as error:
        raise EchoAvatarError(f"the hub refused {name}: {error}; try again later") from error
    except Exception as error:  # its transport raises its own kinds, by version
        if not _is_connection(error):
            raise
        raise EchoAvatarError(
            f"the hub cannot be reached ({type(error).__name__}); what was fetched is kept: run the same command again "
            f"with network, or fetch {name} elsewhere with `hf download {name}` and copy the folder"
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
    """Hold files against their sha256.

    Raises:
        CheckpointError: one differs; it is removed, so that the next pull fetches it anew.
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
                f"{path} is not what the hub says (sha256 {digest.hexdigest()[:12]}..., wanted {wanted[:12]}...); "
                "it was removed, pull again"
            )


def _is_connection(error: BaseException | None) -> bool:
    """Whether the network is what failed, whichever library says so."""
    while error is not None:
        if _CONNECTION & {kind.__name__ for kind in type(error).__mro__}:
            return True
        error = error.__cause__ or error.__context__
    return False
