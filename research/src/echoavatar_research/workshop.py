"""Makes what the tables need, each part once: corpus, tokenizers, codes, generators, motion; finished parts are kept.

Training goes on where it stopped. Tables of one output folder share their parts.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from echoavatar.audio import AudioCodec
from echoavatar.data import Clip, Corpus
from echoavatar.errors import EchoAvatarError
from echoavatar.evaluation.scale import Scale
from echoavatar.evaluation.score import Extractor
from echoavatar.generator import Generator, GeneratorConfig, TokenClip
from echoavatar.generator.recipe import GeneratorTraining
from echoavatar.kinematics import HUMANOID, Motion
from echoavatar.metrics.motion_encoder import MotionEncoder, load_shipped
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar.tokenizer import BodyTokenizer, MotionTokenizerConfig, as_one_part, body_config
from echoavatar.tokens import TokenLayout
from echoavatar.training import Progress

from .choices import GeneratorChoice, TokenizerChoice
from .kept import kept
from .perform import Sounds, live

TOGETHER = 16  # sounds that go through a pipeline at once
LONGER = (
    6  # chunks by which training windows exceed what a position sees, so that the steady stream is trained
)


@dataclass(frozen=True)
class Sources:
    """What is given instead of made.

    Attributes:
        corpus: prepared set; None: a rehearsal corpus is made.
        codec: trained audio codec; None: that of the default bundle.
        extractor: trained FID extractor; None: the shipped one.
        qwen: Qwen2.5-0.5B-Instruct, whose body generators begin with; None: from scratch.
    """

    corpus: Path | None = None
    codec: Path | None = None
    extractor: Path | None = None
    qwen: Path | None = None


class Workshop:
    """Parts of one scale and seed in one folder."""

    def __init__(
        self,
        folder: Path,
        scale: Scale,
        sources: Sources = Sources(),  # noqa: B008  (frozen)
        *,
        device: str = "cpu",
        seed: int = 0,
        workers: int = 1,
        say: Callable[[str], None] = lambda line: None,
        progress: Progress | None = None,
    ) -> None:
        """`workers` make a corpus; `say` is told what is made, `progress` how much of it is done."""
        self.folder, self.scale, self.sources, self.device = folder, scale, sources, device
        self.seed, self.workers, self.say, self.progress = seed, workers, say, progress

    @cached_property
    def corpus(self) -> Corpus:
        """Motion and sound.

        Raises:
            EchoAvatarError: the scale wants a real set and none is given, or it is on another rig than ours.
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
        """The ears of all generators."""
        if self.sources.codec is not None:
            return AudioCodec.load(self.sources.codec).eval()
        from echoavatar.pipeline import load_bundle

        return load_bundle("default").codec

    @cached_property
    def extractor(self) -> Extractor:
        """What FID is taken with."""
        given = self.sources.extractor
        return load_shipped() if given is None else MotionEncoder.load(given)

    @cached_property
    def tests(self) -> list[Clip]:
        """Test clips that are scored, with sound, cut to whole motion tokens."""
        entries = [e for e in self.corpus.entries("test", has_mirrored=False) if e.has_sound]
        return [self.corpus.load(entry.name) for entry in entries[: self.scale.test_clips]]

    @cached_property
    def trained_on(self) -> list[Clip]:
        """Training clips, for the baselines."""
        return [self.corpus.load(name) for name in self.corpus.names("train", has_mirrored=False)]

    def tokenizer(self, choice: TokenizerChoice) -> BodyTokenizer:
        """Trained, or loaded."""
        from echoavatar.tokenizer.train import train_tokenizer

        folder, asked = self.folder / "tokenizers" / choice.name, self._tokenizer_asked(choice)
        sizes = MotionTokenizerConfig.model_validate(asked["sizes"])
        training = self.scale.tokenizer_training.model_copy(
            update={
                "losses": choice.losses,
                "seed": self.seed,
                "is_mirrored": self.corpus.can_mirror,
            }
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

        self._kept(folder, asked, make)
        return BodyTokenizer.load(folder)

    def codes(self, choice: TokenizerChoice) -> list[TokenClip]:
        """The corpus in the codes of a tokenizer."""
        from echoavatar.pipeline.tokenize import tokenize_corpus

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

        self._kept(folder, self._codes_asked(choice), make)
        return [TokenClip.load(path) for path in sorted(folder.glob("*.npz"))]

    def generator(self, choice: GeneratorChoice) -> Generator:
        """Trained, or loaded."""
        from echoavatar.generator.train import train_generator

        folder = self.folder / "generators" / choice.name

        def make() -> None:
            tokenizer = self.tokenizer(choice.tokenizer)
            clips = [clip for clip in self.codes(choice.tokenizer) if is_mostly(clip, choice.only)]
            if not any(clip.split == "train" for clip in clips):
                raise EchoAvatarError(
                    f"no training clip is mostly {choice.only}; give a corpus with some (--corpus)"
                )
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
                "chunks": config.window_chunks + LONGER,
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

        self._kept(folder, self._generator_asked(choice), make)
        return Generator.load(folder)

    def made(self, choice: GeneratorChoice) -> list[Motion]:
        """What a generator makes of the test clips' sound, as long as the clips."""
        folder = self.folder / "made" / choice.name

        def make() -> None:
            tokenizer, generator = self.tokenizer(choice.tokenizer), self.generator(choice)
            for first in range(0, len(self.tests), TOGETHER):
                clips = self.tests[first : first + TOGETHER]
                sounds = {self.seed + first + n: clip.audio for n, clip in enumerate(clips)}
                motions = self._performed(choice.name, tokenizer, generator, sounds)
                for clip, motion in zip(clips, motions, strict=True):
                    moved = replace(clip, rotations=motion.rotations, root=motion.root)
                    moved.save(folder / f"{clip.name}.npz")

        asked = {"generator": self._generator_asked(choice), "clips": [clip.name for clip in self.tests]}
        self._kept(folder, asked, make)
        return [self.motion(Clip.load(folder / f"{clip.name}.npz")) for clip in self.tests]

    def motion(self, clip: Clip) -> Motion:
        """The motion of a clip on the workshop's rig."""
        return motion_of(clip)

    def _performed(
        self, name: str, tokenizer: BodyTokenizer, generator: Generator, sounds: Sounds
    ) -> list[Motion]:
        return live(name, self.codec, tokenizer, generator, sounds, progress=self.progress)

    def _tokenizer_asked(self, choice: TokenizerChoice) -> dict[str, Any]:
        return {
            "corpus": self._digest,
            "sizes": self.scale.tokenizer.model_dump() | dict(choice.sizes),
            "training": self.scale.tokenizer_training.model_dump(mode="json"),
            "losses": choice.losses.model_dump(),
            "is_whole": choice.is_whole,
            "seed": self.seed,
        }

    def _codes_asked(self, choice: TokenizerChoice) -> dict[str, Any]:
        codec = str(self.sources.codec or "default")
        asked = {"tokenizer": self._tokenizer_asked(choice), "codec": codec}
        return asked | {"patience": self.scale.patience}

    def _generator_asked(self, choice: GeneratorChoice) -> dict[str, Any]:
        own = {key: value for key, value in asdict(choice).items() if key != "tokenizer"}
        return {
            "codes": self._codes_asked(choice.tokenizer),
            "choice": own,
            "sizes": self.scale.generator.model_dump(),
            "training": self.scale.generator_training.model_dump(mode="json"),
            "qwen": str(self.sources.qwen or ""),
        }

    @cached_property
    def _digest(self) -> str:
        return hashlib.sha256((self.corpus.folder / "manifest.json").read_bytes()).hexdigest()[:16]

    def _rehearse(self) -> Path:
        from echoavatar.rehearsal.corpus import Plan, rehearse

        if not self.scale.hours:
            raise EchoAvatarError(
                f"scale {self.scale.name} wants a real set: name one of `echoavatar data prepare` (--corpus)"
            )
        folder = self.folder / "corpus"
        plan = Plan(self.scale.hours, self.seed + 1, folder, clip_seconds=self.scale.clip_seconds)
        asked = {"hours": plan.hours, "seed": plan.seed, "clip_seconds": plan.clip_seconds}
        self._kept(folder, asked, lambda: rehearse(plan, workers=self.workers, progress=self.progress))
        return folder

    def _card(self, part: str) -> dict[str, object]:
        bound = self.corpus.manifest.info.get("licence")
        licence = f"as its data: {bound}" if bound else "Apache-2.0"
        return {
            "data": self.corpus.folder.name,
            "command": f"echoavatar reproduce ({part})",
            "licence": licence,
        }

    def _kept(self, folder: Path, asked: Mapping[str, object], make: Callable[[], object]) -> None:
        kept(folder, asked, lambda: (self.say(str(folder.relative_to(self.folder))), make()))


def is_mostly(clip: TokenClip, kind: str | None) -> bool:
    """Whether more of a clip is speech, or music, than the other; any clip for None."""
    speech, music = (int(np.sum(clip.domain == number)) for number in (1, 2))
    return kind is None or (speech > music if kind == "speech" else music > speech)


def motion_of(clip: Clip) -> Motion:
    """The motion of a clip on our rig."""
    return Motion(HUMANOID, clip.rotations, clip.root, float(FRAME_RATE_HZ))
