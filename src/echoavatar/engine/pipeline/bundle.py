"""A bundle: the trained parts that belong together, in one folder.

`codec/`, `tokenizer/`, `generator/` and, optionally, `face/` are checkpoints of their own, the step of which may lie
beside the weights as a graph. `card.json` beside them describes the whole. Other folders are not read.
"""

import atexit
import math
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Literal, Self

from echoavatar.config import Config
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.models.audio.codec_config import CodecConfig
from echoavatar.models.clip_tokenizer import ClipTokenizer
from echoavatar.models.face.config import FaceConfig
from echoavatar.models.generator.config import GeneratorConfig, qwen_half_billion
from echoavatar.models.tokenizer_config import BodyTokenizerConfig
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.stages.post import SWITCHES, refuse_unknown
from echoavatar.nn.exported import ExportedStep, graph_file
from echoavatar.nn.torch_backend import torch_backend
from echoavatar.stored import Stored, read_arrays, read_card, read_config
from echoavatar.timing import CHUNK_SECONDS, ChunkSize

from .actions import ActionLibrary
from .runtime import Runtime

PARTS = ("codec", "tokenizer", "generator")
FACE = "face"
_KINDS: dict[str, type[Config]] = {
    "codec": CodecConfig,
    "tokenizer": BodyTokenizerConfig,
    "generator": GeneratorConfig,
    FACE: FaceConfig,
}
_OPEN = ExitStack()  # folders that stay unpacked until the process ends
atexit.register(_OPEN.close)
_HUB_NAME = re.compile(r"[\w-][\w.-]*/[\w-][\w.-]*")
OPTIONAL_STAGES = (FACE, *SWITCHES)


class Part:
    """A trained part: its config at once, its weights when they are asked for.

    It lies in a checkpoint folder, where its step may be a graph, or it is a module made in this process.
    """

    def __init__(self, name: str, *, folder: Path | None = None, module: Any = None) -> None:
        """Give either `folder` or `module`. Raises CheckpointError if the folder has no config."""
        self.name, self._folder, self._made = name, folder, module
        self.config: Any = module.config if folder is None else read_config(folder, _KINDS[name])

    @cached_property
    def module(self) -> Any:
        """The torch module. Raises CheckpointError if the weights are damaged, DependencyError without the lab."""
        if self._folder is None:
            return self._made
        what = f"the {self.name} of this bundle, whose weights have no graph or run on a GPU,"
        return torch_backend(what).load_part(self.name, self._folder)

    @cached_property
    def graph(self) -> ExportedStep | None:
        """Its step as a graph; None without one of these weights. Raises CheckpointError if it is damaged."""
        return self._exported("step")

    def clip_tokenizer(self, chunk: ChunkSize) -> ClipTokenizer:
        """The tokenizer for whole clips: its graphs, or else its module. Raises as `graph` and `module`."""
        encoder, decoder = self._exported("encoder"), self.graph
        if encoder is None or decoder is None:
            return self.module.clips()  # type: ignore[no-any-return]
        return ClipTokenizer(self.config, encoder, decoder, tokens=chunk.tokens)

    def _exported(self, name: str) -> ExportedStep | None:
        path = None if self._folder is None else graph_file(self._folder, name)
        return ExportedStep(path) if path is not None and path.exists() else None

    def arrays(self) -> Mapping[str, Stored]:
        """Its weights by name. Raises CheckpointError if they are damaged."""
        if self._folder is not None:
            return read_arrays(self._folder)
        return {name: weight.detach().cpu().numpy() for name, weight in self._made.state_dict().items()}


@dataclass(frozen=True)
class Bundle:
    """Codec, motion tokenizer, generator and optional face model, checked against each other."""

    name: str
    parts: Mapping[str, Part]
    card: dict[str, object]
    actions: ActionLibrary = field(default_factory=ActionLibrary)
    runtime: Runtime = field(default_factory=Runtime)

    @classmethod
    def of(cls, name: str, runtime: Runtime, **modules: Any) -> Self:
        """A bundle of modules: `codec`, `tokenizer`, `generator` and, optionally, `face`."""
        return cls(name, {part: Part(part, module=module) for part, module in modules.items()}, {}, runtime=runtime)

    def having(self, **modules: Any) -> Self:
        """The same bundle with other modules as some of its parts; None leaves the face out."""
        others = {name: Part(name, module=module) for name, module in modules.items() if module is not None}
        kept = {name: part for name, part in self.parts.items() if name not in modules}
        return replace(self, parts=kept | others)

    @property
    def codec(self) -> Any:
        """The lab's `AudioCodec`, as `Part.module`; so are the next three."""
        return self.parts["codec"].module

    @property
    def tokenizer(self) -> Any:
        """The lab's `BodyTokenizer`: motion to codes and back."""
        return self.parts["tokenizer"].module

    @property
    def generator(self) -> Any:
        """The lab's `Generator`: audio codes to motion codes."""
        return self.parts["generator"].module

    @property
    def face(self) -> Any:
        """The lab's `FaceModel`, sound to curves; None if the bundle has no face."""
        return self.parts[FACE].module if FACE in self.parts else None

    @property
    def sizes(self) -> GeneratorConfig:
        """The generator's config."""
        return self.parts["generator"].config  # type: ignore[no-any-return]

    @property
    def skeleton(self) -> Skeleton:
        """The tokenizer's rig; `Pipeline.skeleton` is the rig of the output."""
        return Skeleton(self.parts["tokenizer"].config.skeleton)

    @property
    def chunk(self) -> ChunkSize:
        """The chunk of one step."""
        return ChunkSize(self.sizes.step)

    @property
    def parameters(self) -> int:
        """The number of weights of all parts, codebooks included."""
        return sum(math.prod(weight.shape) for part in self.parts.values() for weight in part.arrays().values())

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
        parts = {name: part for name, part in self.parts.items() if name not in stages}
        return replace(self, parts=parts, runtime=runtime)


def load_bundle(name: str | Path = "default") -> Bundle:
    """Load a bundle by the name of a shipped one, from a folder, or as OWNER/NAME from the hub (kept in its cache).

    Raises CheckpointError: no such bundle, a part is missing or damaged, or the parts do not fit together.
    """
    with _folder(name) as folder:
        missing = [part for part in PARTS if not (folder / part).is_dir()]
        if missing:
            raise CheckpointError(f"{folder} is not a bundle: {', '.join(missing)} missing; see `echoavatar bundle`")
        parts = {name: Part(name, folder=folder / name) for name in _KINDS if (folder / name).is_dir()}
        sizes = parts["generator"].config
        width = len(sizes.directed) * sizes.layout.motion_codes
        actions = ActionLibrary.load(folder, width, ChunkSize(sizes.step))
        bundle = Bundle(str(name), parts, read_card(folder), actions, Runtime.load(folder, is_leveled=sizes.is_leveled))
    _check(bundle)
    return bundle


def shipped() -> list[str]:
    """Names of the bundles inside the package."""
    root = files("echoavatar") / "bundles"
    return sorted(e.name for e in root.iterdir() if (e / "generator").is_dir()) if root.is_dir() else []


@contextmanager
def _folder(name: str | Path) -> Iterator[Path]:
    if str(name) in shipped():
        yield _OPEN.enter_context(as_file(files("echoavatar") / "bundles" / str(name)))
        return
    folder = Path(name)
    if not folder.is_dir() and _HUB_NAME.fullmatch(str(name)):
        from echoavatar import hub

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
    if chunks := bundle.sizes.ahead_chunks:
        raise CheckpointError(
            f"bundle {bundle.name}: its generator hears the sound {chunks} chunks ({chunks * CHUNK_SECONDS:.2f} s)"
            " before it is due, so it is an offline reference and cannot stream; train one with ahead_chunks 0"
            " (`echoavatar reproduce main` runs such a reference on whole files)"
        )
    layout, tokenizer = bundle.sizes.layout, bundle.parts["tokenizer"].config
    pairs = [
        ("audio codes", layout.audio_codes, bundle.parts["codec"].config.codes),
        ("motion layers", layout.motion_layers, tokenizer.layers),
        ("motion codes", layout.motion_codes, tokenizer.codes),
        ("body parts", layout.parts, len(tokenizer.parts)),
    ]
    for what, wanted, has in pairs:
        if wanted != has:
            raise CheckpointError(f"bundle {bundle.name}: the generator speaks {wanted} {what}, the other part {has}")
    if FACE in bundle.parts and bundle.chunk.frames % (frames := bundle.parts[FACE].config.step):
        raise CheckpointError(
            f"bundle {bundle.name}: a step of the face has {frames} frames, one of the body {bundle.chunk.frames}"
        )
    if FACE in bundle.parts and (channels := bundle.parts[FACE].config.channels) != len(ARKIT_NAMES):
        raise CheckpointError(f"bundle {bundle.name}: its face has {channels} channels, not the 52 of ARKit")


def with_random_generator(bundle: Bundle, sequence: Literal["prefix", "interleaved", "depth"] = "prefix") -> Bundle:
    """The same bundle with a generator of the paper's size and random weights: to time it, not to look at.

    `prefix` is the paper's own order, which prefills its window at every step. Silence does not bring such a generator
    to rest, so it has no lead-in. The paper's chunk is longer than that of our graphs, so codec and tokenizer are torch
    modules. Raises DependencyError without the lab.
    """
    sizes = qwen_half_billion(bundle.sizes.layout, sequence)
    generator = torch_backend("a model of the paper's size").random_generator(sizes)
    runtime = bundle.runtime.model_copy(update={"lead_in_s": 0.0})
    name = f"{bundle.name}, 0.5B random generator"
    others = {"codec": bundle.codec, "tokenizer": bundle.tokenizer}
    return replace(bundle.having(generator=generator, **others), name=name, runtime=runtime)
