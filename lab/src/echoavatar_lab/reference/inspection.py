"""Check a whole download before anything is written: where each tensor goes, and every problem there is.

`Release` finds each part by the folder and file names under which it was published.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from torch import Tensor

from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.errors import CheckpointError
from echoavatar.models.face import FaceConfig
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar.motion.kinematics import Skeleton, SkeletonConfig
from echoavatar_lab.data.feature_statistics import FeatureStatistics
from echoavatar_lab.foreign.foreign_files import read_array, read_arrays, read_matrices, read_table, read_tensors
from echoavatar_lab.models.face.train import paper_face

from .expected_tensors import differences, face_shapes, from_reference, generator_shapes, hubert_of, tokenizer_shapes
from .release_rig import JOINTS, body_statistics, rig_config, skeleton_config
from .weights import REFERENCE_LAYOUT, StoredGenerator, compacted

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


CHANNELS, HEADS, LOOKBACK = 52, 8, 15
PLACEHOLDER = (0,) * REFERENCE_LAYOUT.audio_layers


class Line(NamedTuple):
    """A published tensor and where it goes in the bundle."""

    file: str
    name: str
    shape: tuple[int, ...]
    target: str


@dataclass
class Inspection:
    """What a download contains; complete where `problems` is empty."""

    lines: list[Line] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    parts: dict[str, MotionTokenizerConfig] = field(default_factory=dict)
    tokenizers: dict[str, dict[str, Tensor]] = field(default_factory=dict)
    face: FaceConfig | None = None
    face_weights: dict[str, Tensor] = field(default_factory=dict)
    face_statistics: dict[str, np.ndarray] = field(default_factory=dict)
    generator: StoredGenerator | None = None
    generator_config: GeneratorConfig | None = None
    skeleton: SkeletonConfig | None = None
    rig: RigConfig | None = None
    statistics: FeatureStatistics | None = None


def inspect_release(release: Release, *, generator: str | None = None, step: int = 2) -> Inspection:
    """Read and check everything without writing. Problems are collected, not raised."""
    found = Inspection()
    for problems in _checks(found, release, generator, step):
        found.problems += problems
    return found


def _checks(found: Inspection, release: Release, generator: str | None, step: int) -> Iterator[list[str]]:
    for part, features in zip(PARTS, (117, 162, 252), strict=True):
        yield _try(partial(_tokenizer, found, release, part, features), f"the tokenizer of the part {part!r}")
    yield _try(lambda: _generator(found, release.generator(generator), step), "the generator")
    yield _try(lambda: _face(found, release.face(), step), "the face model")
    yield _try(lambda: _stats(found, release), "the skeleton and the statistics of the body")
    yield _try(lambda: _face_stats(found, release), "the statistics of the face")


def _try(read: Callable[[], list[str]], what: str) -> list[str]:
    try:
        return read()
    except CheckpointError as error:
        return [str(error)]
    except (ArithmeticError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {str(error)[:160]}"  # sizes and values that no download has
        return [f"{what} holds what no release holds ({reason}); download it again"]


def _tokenizer(found: Inspection, release: Release, part: str, features: int) -> list[str]:
    path = release.tokenizer(part)
    weights = read_tensors(path, "net")
    anchor = weights.get("input_liner.bias")
    if anchor is None or anchor.dim() != 1 or len(anchor) % (2 * HEADS):
        return [f"{path}: input_liner.bias [width] is missing or impossible; download it again"]
    config = MotionTokenizerConfig(
        features=features, width=len(anchor), heads=HEADS, lookback=LOOKBACK, layers=6, codes=release.codes(part)
    )
    shapes = {key: tuple(value.shape) for key, value in weights.items()}
    found.parts[part], found.tokenizers[part] = config, weights
    found.lines += [Line(path.name, key, s, f"tokenizer: parts.{part}.{key}") for key, s in shapes.items()]
    return differences(shapes, tokenizer_shapes(config), origin=str(path))


def _generator(found: Inspection, path: Path, step: int) -> list[str]:
    stored = StoredGenerator.open(path)
    config = stored.generator_config(step=step, silence=PLACEHOLDER)
    full = config.model_copy(update={"layout": REFERENCE_LAYOUT})
    wanted = generator_shapes(full)
    if stored.is_tied:
        del wanted["lm_head.weight"]
    found.generator, found.generator_config = stored, config
    rows = compacted().vocabulary
    for key, shape in stored.shapes.items():
        kept = f" ({rows} rows)" if shape[0] == REFERENCE_LAYOUT.vocabulary else ""
        found.lines.append(Line(stored.files[key].name, key, shape, f"generator: {key}{kept}"))
    return differences(stored.shapes, wanted, origin=str(path))


def _face(found: Inspection, path: Path, step: int) -> list[str]:
    weights = {_present_name(key): value for key, value in read_tensors(path, "gpt").items()}
    shapes = {key: tuple(value.shape) for key, value in weights.items()}
    try:
        hubert, width = hubert_of(shapes), shapes["audio_proj.bias"][0]
        config = paper_face(width=width, encoder=hubert)
    except (LookupError, ValueError, ArithmeticError) as error:
        return [f"{path}: {error} is missing or impossible; download it again"]
    problems = differences(shapes, face_shapes(width, CHANNELS, hubert), origin=str(path))
    found.face = config.model_copy(update={"context": 64 - 4 * step, "step": 4 * step, "least_std": 0.0, "idle": False})
    found.face_weights = weights
    if not problems:
        for key, shape in shapes.items():
            kept = ", ".join(from_reference({key: weights[key]})) or "not used"
            found.lines.append(Line(path.name, key, shape, f"face: {kept}"))
    return problems


def _present_name(key: str) -> str:
    """Older versions of torch store a normalised weight under other names."""
    return key.replace(".conv.weight_g", ".conv.parametrizations.weight.original0").replace(
        ".conv.weight_v", ".conv.parametrizations.weight.original1"
    )


def _stats(found: Inspection, release: Release) -> list[str]:
    path = release.stat(SKELETON)
    table = read_arrays(path, ("names", "parents", "offsets"))
    if table["names"].ndim != 1 or table["offsets"].dtype.kind != "f" or table["parents"].dtype.kind not in "iuf":
        return [f"{path}: names, parents and offsets of joints are of other kinds; download it again"]
    names = tuple(str(name) for name in table["names"])
    if table["offsets"].shape != (len(names), 3) or table["parents"].shape != (len(names),):
        shapes = f"offsets {table['offsets'].shape} and parents {table['parents'].shape}"
        return [f"{path}: {shapes} for {len(names)} joints"]
    found.skeleton = skeleton_config(names, table["parents"].tolist(), table["offsets"], origin=str(path))
    rest = read_matrices(release.stat(REST), names)
    unity = read_matrices(release.stat(UNITY), names)
    found.rig = rig_config(found.skeleton, rest, unity)
    body = release.stat(BODY)
    rows = read_array(body, (2, 6 * JOINTS + 3))
    found.statistics = body_statistics(Skeleton(found.skeleton), rows)
    files = ((path, "skeleton"), (release.stat(REST), "rig.unity"), (release.stat(UNITY), "rig.unity"))
    found.lines += [Line(file.name, f"{len(names)} joints", (len(names),), target) for file, target in files]
    still = int((~found.statistics.varies).sum())
    target = f"tokenizer: mean, std; {still} channels that hardly vary are held at their mean"
    found.lines.append(Line(body.name, "mean, std", tuple(rows.shape), target))
    return []


def _face_stats(found: Inspection, release: Release) -> list[str]:
    path = release.stat(FACE)
    found.face_statistics = read_table(path, ("mean", "std"), (CHANNELS,))
    found.lines.append(Line(path.name, "mean, std", (2, CHANNELS), "face: mean, std"))
    return []
