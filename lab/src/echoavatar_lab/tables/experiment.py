"""Makes what the tables need: corpus, tokenizers, codes, generators and generated motion.

Each part is made once and kept. An interrupted training run resumes. Tables in one output folder share their parts.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object_file
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import BodyTokenizerConfig, MotionTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar.whole_file import write_whole
from echoavatar_lab.align.audio_reward_train import MIRROR
from echoavatar_lab.data import Clip, Corpus
from echoavatar_lab.evaluation.measures import Extractor
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder, load_shipped
from echoavatar_lab.held_folder import hold_folder
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.generator.train import GeneratorTraining
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenize import TokenSettings
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import TokenizerTraining, as_one_part, body_config
from echoavatar_lab.models.tokenizer.variants import AnyBodyTokenizer
from echoavatar_lab.paper import TOKENS
from echoavatar_lab.progress import Progress
from echoavatar_lab.training import train

from .baselines import BASELINES, Baselines
from .generate import Sounds, foreign_motion, live_motion
from .scale import GeneratorChoice, Scale, TokenizerChoice

STAMP = "asked.json"


def make_once(folder: Path, settings: Mapping[str, object], make: Callable[[], object]) -> None:
    """Call `make` unless the part is finished. After an interruption `make` is called again and may resume.

    Raises EchoAvatarError if the folder holds a part that was made with other settings.
    """
    stamp, wanted = folder / STAMP, json.loads(json.dumps(settings))
    if stamp.exists():
        found = read_object_file(stamp)
        if found.get("asked") != wanted:
            raise EchoAvatarError(
                f"{folder} was made with other settings or from other parts; remove it or choose another -o"
            )
        if found.get("is_finished"):
            return
    with hold_folder(folder):
        _write_stamp(stamp, wanted, is_finished=False)
        make()
        _write_stamp(stamp, wanted, is_finished=True)


def _write_stamp(stamp: Path, settings: object, *, is_finished: bool) -> None:
    write_whole(stamp, json.dumps({"asked": settings, "is_finished": is_finished}, indent=1) + "\n")


BATCH = 16  # sounds per batch
EXTRA_CHUNKS = 6  # chunks by which training windows exceed what a position sees, so that the steady stream is trained


@dataclass(frozen=True)
class Sources:
    """Parts that the user gives; what is None is made or taken from the default bundle."""

    corpus: Path | None = None  # prepared set; None: make a rehearsal corpus
    codec: Path | None = None  # trained audio codec; None: the one of the default bundle
    extractor: Path | None = None  # trained FID extractor; None: the shipped one
    qwen: Path | None = None  # Qwen2.5-0.5B-Instruct, the initial weights of generators; None: random weights
    others: Mapping[str, Path] = field(default_factory=dict)  # other systems' motion for the test clips, by name
    is_resampling: bool = False  # take their motion at other rates than 30 fps, too
    model: str | None = None  # its latency is measured; None: the default bundle, at scale `paper` the paper's sizes
    beats: Path | None = None  # published BEATs, the alignment reward's ears; None: a small one that learns along
    sounds: Path | None = None  # corpus of sounds for tuning (`data rl-corpus`); None: one is made


def quiet(line: str) -> None:
    """Say nothing."""


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
        trackers: Sequence[str] = (),
        say: Callable[[str], None] = quiet,
        progress: Progress | None = None,
    ) -> None:
        """`runtime`: how generators run (`Runtime.chosen`). `workers`: processes that make a corpus.

        `trackers`: where else metrics of training go. `say` is called with the name of each part that is made.
        """
        self.folder, self.scale, self.sources, self.device = folder, scale, sources, device
        self.runtime, self.trackers = runtime, tuple(trackers)
        self.seed, self.workers, self.say, self.progress = seed, workers, say, progress

    def again(self, *, seed: int | None = None, device: str | None = None, is_quiet: bool = False) -> Self:
        """The same experiment, perhaps elsewhere, without output; or with another seed, same corpus."""
        is_other = seed is not None and seed != self.seed
        folder = self.folder / "seeds" / str(seed) if is_other else self.folder
        how = self._how() | ({"say": quiet, "progress": None} if is_quiet else {})
        how |= {"device": device or self.device, "seed": self.seed if seed is None else seed}
        return type(self)(folder, self.scale, self._shared_sources() if is_other else self.sources, **how)

    def _how(self) -> dict[str, Any]:
        names = ("device", "seed", "runtime", "workers", "trackers", "say", "progress")
        return {name: getattr(self, name) for name in names}

    def _shared_sources(self) -> Sources:
        """What an experiment with another seed must not make again."""
        return replace(self.sources, corpus=self.corpus.folder)

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
        want_test_clips(corpus)
        return corpus

    @cached_property
    def codec(self) -> AudioCodec:
        """The audio codec of all generators."""
        if self.sources.codec is not None:
            return AudioCodec.load(self.sources.codec).eval()
        from echoavatar.engine.pipeline import load_bundle

        codec: AudioCodec = load_bundle("default").codec
        return codec

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
        from echoavatar_lab.models.tokenizer.train import TokenizerTask

        folder, settings = self.folder / "tokenizers" / choice.name, self._tokenizer_settings(choice)
        sizes = MotionTokenizerConfig.model_validate(settings["sizes"])

        def make() -> None:
            skeleton = self.corpus.skeleton
            config = body_config(as_one_part(skeleton) if choice.is_whole else skeleton, sizes)
            clips = self.corpus.motions("train")
            train(
                TokenizerTask(config, self.tokenizer_training(choice), clips, card=self._card("tokenizer")),
                folder,
                device=self.device,
                trackers=self.trackers,
                progress=self.progress,
            )

        self._make_once(folder, settings, make)
        return AnyBodyTokenizer.load(folder)

    def tokenizer_training(self, choice: TokenizerChoice) -> TokenizerTraining:
        """How a tokenizer is trained."""
        training = self.scale.tokenizer_training
        is_mirrored = training.is_mirrored and self.corpus.can_mirror
        return training.model_copy(update={"losses": choice.losses, "seed": self.seed, "is_mirrored": is_mirrored})

    def token_settings(self) -> TokenSettings:
        """How the corpus is encoded: as in the paper, with the mirrored motion of its alignment reward."""
        return TokenSettings.model_validate(TOKENS["training"] | {"is_mirrored": True})

    def codes(self, choice: TokenizerChoice, clips: Sequence[Clip] | None = None) -> list[TokenClip]:
        """Clips as codes of a tokenizer; by default all, without mirrored motion if the scale's trainings have none.

        The folder holds mirrored motion too, which is positive for the alignment reward.
        """
        from echoavatar_lab.models.tokenize import tokenize_corpus

        folder = self.folder / "tokens" / choice.name

        def make() -> None:
            how = self.token_settings()
            tokenize_corpus(
                self.corpus,
                self.codec,
                self.tokenizer(choice),
                folder,
                is_mirrored_too=how.is_mirrored and self.corpus.can_mirror,
                patience=how.patience,
                is_leveled=how.is_leveled,
                progress=self.progress,
            )

        self._make_once(folder, self.codes_settings(choice), make)
        if clips is not None:
            return [TokenClip.load(folder / f"{clip.name}.npz") for clip in clips]
        paths, is_mirrored = sorted(folder.glob("*.npz")), self.scale.tokenizer_training.is_mirrored
        return [TokenClip.load(path) for path in paths if is_mirrored or not path.stem.endswith(MIRROR)]

    def generator(self, choice: GeneratorChoice) -> Generator:
        """Train a generator of the paper's stage 1, 2 or 3, after the one that it goes on from; or load it.

        Stage 1 is the paper's Embedding Space Alignment: the body is frozen, Qwen's where it is given.
        """
        folder = self.folder / ("stage1" if choice.stage == 1 else "generators") / choice.name
        self._make_once(folder, self._generator_settings(choice), lambda: self._train_generator(choice, folder))
        return Generator.load(folder)

    def _train_generator(self, choice: GeneratorChoice, folder: Path) -> None:
        from echoavatar_lab.models.generator.train import GeneratorTask

        tokenizer = self.tokenizer(choice.tokenizer)
        clips = [clip for clip in self.codes(choice.tokenizer) if is_mostly(clip, choice.only)]
        if not any(clip.split == "train" for clip in clips):
            raise EchoAvatarError(f"no training clip is mostly {choice.only}; give a corpus with some (--corpus)")
        before = choice.before
        train(
            GeneratorTask(
                *self.generator_settings(choice, tokenizer.config),
                clips,
                audio_codebooks=self.codec.codebooks,
                motion_codebooks=tokenizer.codebooks(),
            ),
            folder,
            device=self.device,
            start=self.sources.qwen if before is None else self.generator(before),
            trackers=self.trackers,
            progress=self.progress,
        )

    def generator_settings(
        self, choice: GeneratorChoice, tokenizer: BodyTokenizerConfig
    ) -> tuple[GeneratorConfig, GeneratorTraining]:
        """Sizes of a generator of such a tokenizer's codes, and how it is trained."""
        part = next(iter(tokenizer.parts.values()))
        layout = compact_layout(
            audio_codes=self.codec.config.codes,
            motion_layers=part.layers,
            motion_codes=part.codes,
            parts=len(tokenizer.parts),
            has_example=choice.sizes.get("control") == "prompt",
        )
        sizes = self.scale.generator.model_dump() | dict(choice.sizes) | {"layout": layout, "is_leveled": False}
        config, training = GeneratorConfig.model_validate(sizes), self.scale.generator_trainings[choice.stage]
        chosen: dict[str, Any] = {
            "chunks": config.window_chunks + EXTRA_CHUNKS,
            "depth_weights": tuple(0.7**layer for layer in range(part.layers)),
            "seed": self.seed,
        }
        return config, GeneratorTraining.model_validate(training.model_dump() | chosen | dict(choice.training))

    def generated_motions(self, choice: GeneratorChoice) -> list[Motion]:
        """Motion that a generator makes for the sound of the test clips, as long as the clips."""
        folder = self.folder / "made" / self.runtime / choice.name

        def make() -> None:
            self.write_motions(folder, self.tokenizer(choice.tokenizer), self.generator(choice))

        settings = {
            "generator": self._generator_settings(choice),
            "runtime": self.runtime,
            "clips": [clip.name for clip in self.test_clips],
        }
        self._make_once(folder, settings, make)
        return self.written_motions(folder)

    def write_motions(self, folder: Path, tokenizer: BodyTokenizer, generator: Generator) -> None:
        """Write a clip for each test clip, with the motion that a generator makes for its sound; kept ones stay."""
        for first in range(0, len(self.test_clips), BATCH):
            numbered = list(enumerate(self.test_clips[first : first + BATCH], self.seed + first))
            left = {seed: clip for seed, clip in numbered if not (folder / f"{clip.name}.npz").exists()}
            if not left:
                continue
            sounds = {seed: clip.audio for seed, clip in left.items()}
            motions = self._generate(folder.name, tokenizer, generator, sounds)
            for clip, motion in zip(left.values(), motions, strict=True):
                with_motion(clip, motion).save(folder / f"{clip.name}.npz")

    def written_motions(self, folder: Path) -> list[Motion]:
        """What `write_motions` wrote."""
        return [Clip.load(folder / f"{clip.name}.npz").motion(self.rig) for clip in self.test_clips]

    def foreign_motions(self) -> dict[str, list[Motion]]:
        """Motion of other systems for the test clips, by the systems' names, on the rig of this experiment.

        Raises:
            EchoAvatarError: a folder lacks a clip, or one is too short or cannot be used; the message names the file.
        """
        is_resampling = self.sources.is_resampling
        return {
            name: [foreign_motion(folder, clip, self.rig, is_resampling=is_resampling) for clip in self.test_clips]
            for name, folder in self.sources.others.items()
        }

    @cached_property
    def true_motions(self) -> list[Motion]:
        """The motion of the test clips."""
        return [clip.motion(self.rig) for clip in self.test_clips]

    @property
    def rig(self) -> Skeleton:
        """The rig of all clips and all generated motion."""
        return HUMANOID

    def baseline_motions(self) -> Iterator[tuple[str, list[Motion]]]:
        """Names of the baselines and their motion for the test clips; clip k has the seed `seed` + k."""
        baselines = Baselines(self.train_clips, self.rig)
        for name, kind in BASELINES.items():
            self.say(f"line: {name}")
            sounds = enumerate(self.test_clips, self.seed)
            yield name, [baselines.make(kind, clip.audio, seed=seed) for seed, clip in sounds]

    def _generate(self, name: str, tokenizer: BodyTokenizer, generator: Generator, sounds: Sounds) -> list[Motion]:
        how = {"runtime": self.runtime, "device": self.device}
        return live_motion(name, self.codec, tokenizer, generator, sounds, **how, progress=self.progress)

    def _tokenizer_settings(self, choice: TokenizerChoice) -> dict[str, Any]:
        return {
            "corpus": self._digest,
            "sizes": self.scale.tokenizer.model_dump() | dict(choice.sizes),
            "training": self.scale.tokenizer_training.model_dump(mode="json"),
            "losses": choice.losses.model_dump(),
            "is_whole": choice.is_whole,
            "seed": self.seed,
        }

    def codes_settings(self, choice: TokenizerChoice) -> dict[str, Any]:
        """What the codes of a tokenizer depend on; what is trained on them is stamped with it."""
        return {"tokenizer": self._tokenizer_settings(choice), "codec": self._codec_mark, "is_leveled": False}

    def _generator_settings(self, choice: GeneratorChoice) -> dict[str, Any]:
        before, qwen = choice.before, str(self.sources.qwen or "")
        return {
            "start": {"qwen": qwen} if before is None else self._generator_settings(before),
            "training": self.scale.generator_trainings[choice.stage].model_dump(mode="json"),
            "codes": self.codes_settings(choice.tokenizer),
            "sizes": self.scale.generator.model_dump() | dict(choice.sizes),
            "choice": {"name": choice.name, "training": dict(choice.training), "only": choice.only},
        }

    @cached_property
    def _codec_mark(self) -> str:
        from echoavatar_lab.align.trainer import fingerprint

        return fingerprint(self.codec)

    @cached_property
    def _digest(self) -> str:
        return hashlib.sha256((self.corpus.folder / "manifest.json").read_bytes()).hexdigest()[:16]

    def _rehearse(self) -> Path:
        from echoavatar_lab.corpora.rehearsal.corpus import Plan, rehearse

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


def want_test_clips(corpus: Corpus) -> None:
    """Raise EchoAvatarError unless a set holds clips out: two for testing, and some to train on."""
    found = {split: len(corpus.names(split, has_mirrored=False)) for split in ("train", "val", "test")}
    if found["test"] < 2 or not found["train"]:
        counts = ", ".join(f"{count} {split}" for split, count in found.items())
        raise EchoAvatarError(
            f"{corpus.folder} has no split to test on ({counts}): fewer than two test clips or nothing to train on;"
            " prepare it again with --test-every 10, or give a larger set"
        )


def is_mostly(clip: TokenClip, kind: str | None) -> bool:
    """Whether a clip has more speech than music (`kind` "speech") or the reverse ("music"); None accepts any clip."""
    speech, music = (int(np.sum(clip.domain == number)) for number in (1, 2))
    return kind is None or (speech > music if kind == "speech" else music > speech)


def with_motion(clip: Clip, motion: Motion) -> Clip:
    """The clip with other motion, cut to what both have."""
    frames = min(clip.frames, motion.frames)
    return replace(
        clip,
        audio=clip.audio[: frames * SAMPLES_PER_FRAME],
        domain=clip.domain[:frames],
        rotations=motion.rotations[:frames],
        root=motion.root[:frames],
    )
