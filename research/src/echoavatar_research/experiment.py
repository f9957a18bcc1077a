"""Makes what the tables need: corpus, tokenizers, codes, generators and generated motion.

Each part is made once and kept. An interrupted training run resumes. Tables in one output folder share their parts.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from echoavatar.data import Clip, Corpus
from echoavatar.errors import EchoAvatarError
from echoavatar.evaluation.metrics.motion_encoder import MotionEncoder, load_shipped
from echoavatar.evaluation.score import Extractor
from echoavatar.models.audio import AudioCodec
from echoavatar.models.generator import Generator, GeneratorConfig, TokenClip
from echoavatar.models.generator.recipe import GeneratorTraining
from echoavatar.models.tokenizer import BodyTokenizer, MotionTokenizerConfig, as_one_part, body_config
from echoavatar.models.tokens import TokenLayout
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar.training import Progress
from echoavatar_research.scale import Scale

from .choices import GeneratorChoice, TokenizerChoice
from .generate import Sounds, live_motion
from .make_once import make_once

BATCH = 16  # sounds per batch
EXTRA_CHUNKS = 6  # chunks by which training windows exceed what a position sees, so that the steady stream is trained


@dataclass(frozen=True)
class Sources:
    """Parts that the user gives; what is None is made or taken from the default bundle.

    Attributes:
        corpus: prepared set; None: make a rehearsal corpus.
        codec: trained audio codec; None: the one of the default bundle.
        extractor: trained FID extractor; None: the shipped one.
        qwen: Qwen2.5-0.5B-Instruct, the initial weights of generators; None: random weights.
    """

    corpus: Path | None = None
    codec: Path | None = None
    extractor: Path | None = None
    qwen: Path | None = None


class Experiment:
    """All parts of one scale and one seed, in one folder."""

    def __init__(
        self,
        folder: Path,
        scale: Scale,
        sources: Sources = Sources(),  # noqa: B008  (frozen)
        *,
        device: str = "cpu",
        seed: int = 0,
        runtime: str = "paper",
        workers: int = 1,
        say: Callable[[str], None] = lambda line: None,
        progress: Progress | None = None,
    ) -> None:
        """`runtime`: how generators run (`Runtime.chosen`). `workers`: processes that make a corpus.

        `say` is called with the name of each part that is made.
        """
        self.folder, self.scale, self.sources, self.device = folder, scale, sources, device
        self.runtime = runtime
        self.seed, self.workers, self.say, self.progress = seed, workers, say, progress

    @cached_property
    def corpus(self) -> Corpus:
        """Motion and sound.

        Raises:
            EchoAvatarError: the scale needs a real set and none is given, or the set is on another rig or too small.
        """
        folder = self.sources.corpus or self._rehearse()
        corpus = Corpus(folder)
        if corpus.skeleton.names != HUMANOID.names:
            raise EchoAvatarError(f"{folder} is on a rig of its own; prepare it with --rig unified")
        if len(corpus.names("test", has_mirrored=False)) < 2:
            raise EchoAvatarError(f"{folder} has fewer than two test clips; give a larger corpus")
        return corpus

    @cached_property
    def codec(self) -> AudioCodec:
        """The audio codec of all generators."""
        if self.sources.codec is not None:
            return AudioCodec.load(self.sources.codec).eval()
        from echoavatar.engine.pipeline import load_bundle

        return load_bundle("default").codec

    @cached_property
    def extractor(self) -> Extractor:
        """The feature extractor of FID."""
        given = self.sources.extractor
        return load_shipped() if given is None else MotionEncoder.load(given)

    @cached_property
    def test_clips(self) -> list[Clip]:
        """The test clips that are scored: those with sound, cut to whole motion tokens."""
        entries = [e for e in self.corpus.entries("test", has_mirrored=False) if e.has_sound]
        return [self.corpus.load(entry.name) for entry in entries[: self.scale.test_clips]]

    @cached_property
    def train_clips(self) -> list[Clip]:
        """Training clips, which the baselines draw from."""
        return [self.corpus.load(name) for name in self.corpus.names("train", has_mirrored=False)]

    def tokenizer(self, choice: TokenizerChoice) -> BodyTokenizer:
        """Train the tokenizer, or load it if it is finished."""
        from echoavatar.models.tokenizer.train import train_tokenizer

        folder, settings = self.folder / "tokenizers" / choice.name, self._tokenizer_settings(choice)
        sizes = MotionTokenizerConfig.model_validate(settings["sizes"])
        training = self.scale.tokenizer_training.model_copy(
            update={"losses": choice.losses, "seed": self.seed, "is_mirrored": self.corpus.can_mirror}
        )

        def make() -> None:
            skeleton = self.corpus.skeleton
            config = body_config(as_one_part(skeleton) if choice.is_whole else skeleton, sizes)
            clips = [self.corpus.motion(name) for name in self.corpus.names("train", has_mirrored=False)]
            train_tokenizer(
                config,
                training,
                clips,
                [],
                folder,
                card=self._card("tokenizer"),
                device=self.device,
                progress=self.progress,
            )

        self._make_once(folder, settings, make)
        return BodyTokenizer.load(folder)

    def codes(self, choice: TokenizerChoice) -> list[TokenClip]:
        """The corpus as codes of a tokenizer."""
        from echoavatar.engine.pipeline.tokenize import tokenize_corpus

        folder = self.folder / "tokens" / choice.name

        def make() -> None:
            tokenize_corpus(
                self.corpus,
                self.codec,
                self.tokenizer(choice),
                folder,
                is_mirrored_too=self.corpus.can_mirror,
                patience=self.scale.patience,
                progress=self.progress,
            )

        self._make_once(folder, self._codes_settings(choice), make)
        return [TokenClip.load(path) for path in sorted(folder.glob("*.npz"))]

    def generator(self, choice: GeneratorChoice) -> Generator:
        """Train the generator, or load it if it is finished."""
        from echoavatar.models.generator.train import train_generator

        folder = self.folder / "generators" / choice.name

        def make() -> None:
            tokenizer = self.tokenizer(choice.tokenizer)
            clips = [clip for clip in self.codes(choice.tokenizer) if is_mostly(clip, choice.only)]
            if not any(clip.split == "train" for clip in clips):
                raise EchoAvatarError(f"no training clip is mostly {choice.only}; give a corpus with some (--corpus)")
            layers = tokenizer.config.layers
            layout = TokenLayout.compact(
                audio_codes=self.codec.config.codes,
                motion_layers=layers,
                motion_codes=tokenizer.config.codes,
                parts=len(tokenizer.config.parts),
            )
            sizes = self.scale.generator.model_dump() | dict(choice.sizes)
            config = GeneratorConfig(layout=layout, patience=self.scale.patience, **sizes)
            chosen: dict[str, Any] = {
                "chunks": config.window_chunks + EXTRA_CHUNKS,
                "depth_weights": tuple(0.7**layer for layer in range(layers)),
                "seed": self.seed,
            }
            training = self.scale.generator_training.model_dump() | chosen | dict(choice.training)
            train_generator(
                config,
                GeneratorTraining.model_validate(training),
                clips,
                folder,
                device=self.device,
                qwen=self.sources.qwen,
                audio_codebooks=self.codec.codebooks,
                motion_codebooks=tokenizer.codebooks(),
                progress=self.progress,
            )

        self._make_once(folder, self._generator_settings(choice), make)
        return Generator.load(folder)

    def generated_motions(self, choice: GeneratorChoice) -> list[Motion]:
        """Motion that a generator makes for the sound of the test clips, as long as the clips."""
        folder = self.folder / "made" / self.runtime / choice.name

        def make() -> None:
            tokenizer, generator = self.tokenizer(choice.tokenizer), self.generator(choice)
            for first in range(0, len(self.test_clips), BATCH):
                clips = self.test_clips[first : first + BATCH]
                sounds = {self.seed + first + n: clip.audio for n, clip in enumerate(clips)}
                motions = self._generate(choice.name, tokenizer, generator, sounds)
                for clip, motion in zip(clips, motions, strict=True):
                    moved = replace(clip, rotations=motion.rotations, root=motion.root)
                    moved.save(folder / f"{clip.name}.npz")

        settings = {
            "generator": self._generator_settings(choice),
            "runtime": self.runtime,
            "clips": [clip.name for clip in self.test_clips],
        }
        self._make_once(folder, settings, make)
        return [self.motion(Clip.load(folder / f"{clip.name}.npz")) for clip in self.test_clips]

    def motion(self, clip: Clip) -> Motion:
        """The motion of a clip on the rig of this experiment."""
        return motion_of(clip)

    def _generate(self, name: str, tokenizer: BodyTokenizer, generator: Generator, sounds: Sounds) -> list[Motion]:
        return live_motion(name, self.codec, tokenizer, generator, sounds, runtime=self.runtime, progress=self.progress)

    def _tokenizer_settings(self, choice: TokenizerChoice) -> dict[str, Any]:
        return {
            "corpus": self._digest,
            "sizes": self.scale.tokenizer.model_dump() | dict(choice.sizes),
            "training": self.scale.tokenizer_training.model_dump(mode="json"),
            "losses": choice.losses.model_dump(),
            "is_whole": choice.is_whole,
            "seed": self.seed,
        }

    def _codes_settings(self, choice: TokenizerChoice) -> dict[str, Any]:
        codec = str(self.sources.codec or "default")
        settings = {"tokenizer": self._tokenizer_settings(choice), "codec": codec}
        return settings | {"patience": self.scale.patience}

    def _generator_settings(self, choice: GeneratorChoice) -> dict[str, Any]:
        own = {key: value for key, value in asdict(choice).items() if key != "tokenizer"}
        return {
            "codes": self._codes_settings(choice.tokenizer),
            "choice": own,
            "sizes": self.scale.generator.model_dump(),
            "training": self.scale.generator_training.model_dump(mode="json"),
            "qwen": str(self.sources.qwen or ""),
        }

    @cached_property
    def _digest(self) -> str:
        return hashlib.sha256((self.corpus.folder / "manifest.json").read_bytes()).hexdigest()[:16]

    def _rehearse(self) -> Path:
        from echoavatar.corpora.rehearsal.corpus import Plan, rehearse

        if not self.scale.hours:
            raise EchoAvatarError(
                f"scale {self.scale.name} needs a real set: give one made by `echoavatar data prepare` (--corpus)"
            )
        folder = self.folder / "corpus"
        plan = Plan(self.scale.hours, self.seed + 1, folder, clip_seconds=self.scale.clip_seconds)
        settings = {"hours": plan.hours, "seed": plan.seed, "clip_seconds": plan.clip_seconds}
        self._make_once(folder, settings, lambda: rehearse(plan, workers=self.workers, progress=self.progress))
        return folder

    def _card(self, part: str) -> dict[str, object]:
        bound = self.corpus.manifest.info.get("licence")
        licence = f"as its data: {bound}" if bound else "Apache-2.0"
        return {"data": self.corpus.folder.name, "command": f"echoavatar reproduce ({part})", "licence": licence}

    def _make_once(self, folder: Path, settings: Mapping[str, object], make: Callable[[], object]) -> None:
        make_once(folder, settings, lambda: (self.say(str(folder.relative_to(self.folder))), make()))


def is_mostly(clip: TokenClip, kind: str | None) -> bool:
    """Whether a clip has more speech than music (`kind` "speech") or the reverse ("music"); None accepts any clip."""
    speech, music = (int(np.sum(clip.domain == number)) for number in (1, 2))
    return kind is None or (speech > music if kind == "speech" else music > speech)


def motion_of(clip: Clip) -> Motion:
    """The motion of a clip, on our rig."""
    return Motion(HUMANOID, clip.rotations, clip.root, float(FRAME_RATE_HZ))
