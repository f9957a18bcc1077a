"""A bundle: the trained parts that belong together, in one folder.

`codec/`, `tokenizer/`, `generator/` and, optionally, `face/` are checkpoints of their own, the step of which may lie
beside the weights as a graph. `card.json` beside them describes the whole. Other folders are not read.
"""

import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Literal

from echoavatar import hub
from echoavatar.checkpoint import read_card
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.models.audio import AudioCodec
from echoavatar.models.face import FaceModel
from echoavatar.models.generator import Generator, qwen_half_billion
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.stages.post import SWITCHES, refuse_unknown
from echoavatar.nn.exported import ExportedStep, graph_file
from echoavatar.timing import CHUNK_SECONDS, ChunkSize

from .actions import ActionLibrary
from .runtime import Runtime

PARTS = ("codec", "tokenizer", "generator")
FACE = "face"
EXPORTED = ("codec", "tokenizer", FACE)  # parts whose step may be a graph
_HUB_NAME = re.compile(r"[\w-][\w.-]*/[\w-][\w.-]*")
OPTIONAL_STAGES = (FACE, *SWITCHES)


@dataclass(frozen=True)
class Bundle:
    """Codec, motion tokenizer, generator and optional face model, loaded and checked against each other."""

    name: str
    codec: AudioCodec
    tokenizer: BodyTokenizer
    generator: Generator
    card: dict[str, object]
    actions: ActionLibrary = field(default_factory=ActionLibrary)
    face: FaceModel | None = None
    runtime: Runtime = field(default_factory=Runtime)
    steps: dict[str, ExportedStep] = field(default_factory=dict)  # of parts that have a graph, for a CPU

    @property
    def skeleton(self) -> Skeleton:
        """The tokenizer's rig; `Pipeline.skeleton` is the rig of the output."""
        return self.tokenizer.skeleton

    @property
    def chunk(self) -> ChunkSize:
        """The chunk of one step."""
        return ChunkSize(self.generator.config.step)

    @property
    def parameters(self) -> int:
        """The number of weights of all parts."""
        parts = (self.codec, self.tokenizer, self.generator, self.face)
        return sum(weight.numel() for part in parts if part is not None for weight in part.parameters())

    def running(self, runtime: str) -> "Bundle":
        """The same bundle run as `paper`, `default` or with some of our additions, see `Runtime.chosen`.

        Raises EchoAvatarError if there is no such addition.
        """
        return replace(self, runtime=self.runtime.chosen(runtime))

    def without(self, stages: Collection[str]) -> "Bundle":
        """The same bundle with some stages left out: the face, or stages behind the decoder.

        Raises EchoAvatarError if there is no stage of that name.
        """
        refuse_unknown(stages, OPTIONAL_STAGES)
        kept = tuple(stage for stage in self.runtime.stages if stage not in stages)
        runtime = self.runtime.model_copy(update={"stages": kept})
        return replace(self, face=None if FACE in stages else self.face, runtime=runtime)


def load_bundle(name: str | Path = "default") -> Bundle:
    """Load a bundle by the name of a shipped one, from a folder, or as OWNER/NAME from the hub (kept in its cache).

    Raises CheckpointError: no such bundle, a part is missing or damaged, or the parts do not fit together.
    """
    with _folder(name) as folder:
        missing = [part for part in PARTS if not (folder / part).is_dir()]
        if missing:
            raise CheckpointError(f"{folder} is not a bundle: {', '.join(missing)} missing; see `echoavatar bundle`")
        codec = AudioCodec.load(folder / "codec").eval()
        tokenizer = BodyTokenizer.load(folder / "tokenizer").eval()
        generator = Generator.load(folder / "generator").eval()
        width = len(generator.config.directed) * generator.config.layout.motion_codes
        chunk = ChunkSize(generator.config.step)
        actions = ActionLibrary.load(folder, width, chunk)
        face = FaceModel.load(folder / "face") if (folder / "face").is_dir() else None
        runtime = Runtime.load(folder, is_leveled=generator.config.is_leveled)
        graphs = {part: graph_file(folder / part) for part in EXPORTED if (folder / part).is_dir()}
        steps = {part: ExportedStep(graph) for part, graph in graphs.items() if graph.exists()}
        bundle = Bundle(str(name), codec, tokenizer, generator, read_card(folder), actions, face, runtime, steps)
    _check(bundle)
    return bundle


def shipped() -> list[str]:
    """Names of the bundles inside the package."""
    root = files("echoavatar") / "bundles"
    return sorted(e.name for e in root.iterdir() if (e / "generator").is_dir()) if root.is_dir() else []


@contextmanager
def _folder(name: str | Path) -> Iterator[Path]:
    if str(name) in shipped():
        with as_file(files("echoavatar") / "bundles" / str(name)) as folder:
            yield folder
        return
    folder = Path(name)
    if not folder.is_dir() and _HUB_NAME.fullmatch(str(name)):
        try:
            folder = hub.fetch(str(name))
        except EchoAvatarError as error:
            raise CheckpointError(
                f"no bundle {str(name)!r}: not a folder, and as a name on the hub: {error}"
            ) from error
    if not folder.is_dir():
        known = ", ".join(shipped()) or "none"
        raise CheckpointError(f"no bundle {str(name)!r}: not a folder and not shipped (shipped: {known})")
    yield folder


def _check(bundle: Bundle) -> None:
    if chunks := bundle.generator.config.ahead_chunks:
        raise CheckpointError(
            f"bundle {bundle.name}: its generator hears the sound {chunks} chunks ({chunks * CHUNK_SECONDS:.2f} s)"
            " before it is due, so it is an offline reference and cannot stream; train one with ahead_chunks 0"
            " (`echoavatar reproduce main` runs such a reference on whole files)"
        )
    layout, tokenizer = bundle.generator.config.layout, bundle.tokenizer.config
    pairs = [
        ("audio codes", layout.audio_codes, bundle.codec.config.codes),
        ("motion layers", layout.motion_layers, tokenizer.layers),
        ("motion codes", layout.motion_codes, tokenizer.codes),
        ("body parts", layout.parts, len(tokenizer.parts)),
    ]
    for what, wanted, has in pairs:
        if wanted != has:
            raise CheckpointError(f"bundle {bundle.name}: the generator speaks {wanted} {what}, the other part {has}")
    if bundle.face and bundle.face.config.channels != len(ARKIT_NAMES):
        raise CheckpointError(
            f"bundle {bundle.name}: its face has {bundle.face.config.channels} channels, not the 52 of ARKit"
        )


def with_random_generator(bundle: Bundle, sequence: Literal["prefix", "interleaved", "depth"] = "prefix") -> Bundle:
    """The same bundle with a generator of the paper's size and random weights: to time it, not to look at.

    `prefix` is the paper's own order, which prefills its window at every step.

    Silence does not bring it to rest, so it has no lead-in.
    """
    layout = bundle.generator.config.layout
    generator = Generator(qwen_half_billion(layout, sequence)).eval()
    runtime = bundle.runtime.model_copy(update={"lead_in_s": 0.0})
    name = f"{bundle.name}, 0.5B random generator"
    return replace(bundle, name=name, generator=generator, runtime=runtime)
