"""Check a whole download before anything is written: where each tensor goes, and every problem there is."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from torch import Tensor

from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.errors import CheckpointError
from echoavatar.models.face import FaceConfig, paper_face
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer import MotionTokenizerConfig
from echoavatar.models.tokens import REFERENCE_LAYOUT
from echoavatar.motion.kinematics import FeatureStatistics, Skeleton, SkeletonConfig
from echoavatar_lab.foreign.foreign_files import read_array, read_arrays, read_matrices, read_table, read_tensors
from echoavatar_lab.reference.face import from_reference

from . import folder
from .expected_tensors import differences, face_shapes, generator_shapes, hubert_of, tokenizer_shapes
from .folder import Release
from .release_rig import JOINTS, rig_config, skeleton_config
from .statistics import body_statistics
from .vocabulary import compacted
from .weights import StoredGenerator

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
    for part, features in zip(folder.PARTS, (117, 162, 252), strict=True):
        yield _try(partial(_tokenizer, found, release, part, features))
    yield _try(lambda: _generator(found, release.generator(generator), step))
    yield _try(lambda: _face(found, release.face(), step))
    yield _try(lambda: _stats(found, release))
    yield _try(lambda: _face_stats(found, release))


def _try(read: Callable[[], list[str]]) -> list[str]:
    try:
        return read()
    except CheckpointError as error:
        return [str(error)]


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
    path = release.stat(folder.SKELETON)
    table = read_arrays(path, ("names", "parents", "offsets"))
    names = tuple(str(name) for name in table["names"])
    if table["offsets"].shape != (len(names), 3) or table["parents"].shape != (len(names),):
        shapes = f"offsets {table['offsets'].shape} and parents {table['parents'].shape}"
        return [f"{path}: {shapes} for {len(names)} joints"]
    found.skeleton = skeleton_config(names, table["parents"].tolist(), table["offsets"], origin=str(path))
    rest = read_matrices(release.stat(folder.REST), names)
    unity = read_matrices(release.stat(folder.UNITY), names)
    found.rig = rig_config(found.skeleton, rest, unity)
    body = release.stat(folder.BODY)
    rows = read_array(body, (2, 6 * JOINTS + 3))
    found.statistics = body_statistics(Skeleton(found.skeleton), rows)
    files = ((path, "skeleton"), (release.stat(folder.REST), "rig.unity"), (release.stat(folder.UNITY), "rig.unity"))
    found.lines += [Line(file.name, f"{len(names)} joints", (len(names),), target) for file, target in files]
    still = int((~found.statistics.varies).sum())
    target = f"tokenizer: mean, std; {still} channels that hardly vary are held at their mean"
    found.lines.append(Line(body.name, "mean, std", tuple(rows.shape), target))
    return []


def _face_stats(found: Inspection, release: Release) -> list[str]:
    path = release.stat(folder.FACE)
    found.face_statistics = read_table(path, ("mean", "std"), (CHANNELS,))
    found.lines.append(Line(path.name, "mean, std", (2, CHANNELS), "face: mean, std"))
    return []
