"""Where each part of a download is, by the folder and file names under which it was published."""

import re
from dataclasses import dataclass
from pathlib import Path

from echoavatar.errors import CheckpointError

PARTS = ("lower", "upper", "hands")
GENERATORS = ("body_g_d", "body_g")  # gesture and dance, gesture alone
SKELETON, BODY, FACE = "zm_meta_info.npz", "body_mean_std_30fps.npy", "arkit_mean_std_30fps.npy"
REST, UNITY = "magic_rest_matrices.json", "magic_transforms.json"


@dataclass(frozen=True)
class Release:
    """The user's download: `ckpts` comes from the hub, `stats` from the authors' repository."""

    ckpts: Path
    stats: Path

    def tokenizer(self, part: str) -> Path:
        """Weights of a body part's tokenizer."""
        home = _folder(self.ckpts / "body_rvqvae", "the three tokenizers")
        return _newest(_only(home, f"*_bp_{part}_*", f"the tokenizer of the part {part!r}"), "net")

    def codes(self, part: str) -> int:
        """Codes per layer; only the folder's name states it."""
        name = self.tokenizer(part).parent.name
        found = re.search(r"nb-code_(\d+)", name)
        if not found:
            raise CheckpointError(
                f"the name of the folder {name} does not contain nb-code_N; keep the name it was published under"
            )
        return int(found[1])

    def face(self) -> Path:
        """Weights of the face model."""
        home = _folder(self.ckpts / "face", "the face model")
        return _newest(_only(home, "*FaceGPT*", "the face model"), "gpt")

    def generator(self, name: str | None = None) -> Path:
        """Folder of the named generator, or of the first of `GENERATORS` that is there."""
        names = [name] if name else [own for own in GENERATORS if (self.ckpts / own).is_dir()] or [GENERATORS[0]]
        return _folder(self.ckpts / names[0], "the generator")

    def stat(self, name: str) -> Path:
        """A file of the stats folder."""
        path = _folder(self.stats, "the release's statistics and skeleton") / name
        if not path.is_file():
            raise CheckpointError(f"{path} is missing; --stats is the folder 'stats' of the authors' repository")
        return path


def _folder(path: Path, what: str) -> Path:
    if not path.is_dir():
        home = path.parent
        there = sorted(own.name for own in home.iterdir()) if home.is_dir() else []
        raise CheckpointError(
            f"no folder {path}, which holds {what}; {home} has: {', '.join(there) or 'nothing'}. "
            "Keep the names under which it was published"
        )
    return path


def _only(home: Path, pattern: str, what: str) -> Path:
    found = sorted(path for path in home.glob(pattern) if path.is_dir())
    if len(found) != 1:
        names = found or sorted(home.iterdir())
        there = ", ".join(path.name for path in names) or "nothing"
        raise CheckpointError(
            f"{home} has {len(found) or 'no'} folders {pattern}, wanted one for {what}; it has: {there}. "
            "Keep the names under which it was published"
        )
    return found[0]


def _newest(folder: Path, stem: str) -> Path:
    """The file with the highest training step."""
    found = {int(m[1]): path for path in folder.iterdir() if (m := re.fullmatch(rf"{stem}_(\d+)\.pth", path.name))}
    if not found:
        raise CheckpointError(f"{folder} has no {stem}_STEP.pth; download it again")
    return found[max(found)]
