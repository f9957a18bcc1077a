"""The experiment behind the BEAT2 table: SMPL-X's 55 joints as recorded, and EMAGE's extractor or one like it."""

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Self

import torch
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError
from echoavatar.files.exports.smplx import skeleton
from echoavatar.models.generator import Generator
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import Motion
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.data import Clip, Corpus
from echoavatar_lab.datasets import Options, prepare, survey_of
from echoavatar_lab.tables.scale import ScaleName

from .beat2_sample import write_sample
from .experiment import Experiment, Sources, want_test_clips
from .generate import Sounds, decoded_motion
from .skeleton_convolution import SkeletonConvolution, SkeletonConvolutionConfig, extractor_input
from .skeleton_convolution_train import SkeletonConvolutionTraining, train_skeleton_convolution

SPEAKERS = ("2",)  # the speaker of EMAGE's and MECo's tables; the paper does not name its own
OPTIONS = Options(rig="native", fingers="keep")
EXTRACTOR_STEPS: dict[ScaleName, int] = {"tiny": 20, "rehearsal": 1500, "paper": 20_000}
LEAST_SECONDS = 8.0  # EMAGE's beat alignment cuts two seconds off both ends
LEAST_CLIPS = 24


class Beat2Experiment(Experiment):
    """All parts of the BEAT2 table, in a subfolder of their own."""

    @classmethod
    def of(cls, other: Experiment) -> Self:
        """A BEAT2 experiment with the sources and settings of another experiment."""
        return cls(
            other.folder / "beat2",
            other.scale,
            other.sources,
            device=other.device,
            seed=other.seed,
            workers=other.workers,
            trackers=other.trackers,
            say=other.say,
            progress=other.progress,
        )

    def _shared_sources(self) -> Sources:
        """Corpus, and the extractor: distances in different latents cannot be compared."""
        _ = self.extractor
        return replace(super()._shared_sources(), extractor=self.sources.extractor or self.folder / "extractor")

    @cached_property
    def is_synthetic(self) -> bool:
        """Whether the user gave no copy of the dataset."""
        return self.sources.corpus is None

    @cached_property
    def corpus(self) -> Corpus:
        """The set on SMPL-X's joints: given, or prepared from the user's copy or from a synthetic copy.

        Raises:
            EchoAvatarError: the scale needs a copy and none is given, or the set is on another rig or too small.
        """
        given = self.sources.corpus
        is_prepared = given is not None and (given / "manifest.json").is_file()
        corpus = Corpus(given if given is not None and is_prepared else self._prepared(given or self._sample()))
        if corpus.skeleton.names != skeleton().names:
            raise EchoAvatarError(
                f"{corpus.folder} is not on SMPL-X's joints; prepare it with"
                " `echoavatar data prepare beat2 ... --rig native --fingers keep`"
            )
        want_test_clips(corpus)
        return corpus

    @cached_property
    def extractor(self) -> SkeletonConvolution:
        """EMAGE's extractor from the user's folder, or one of ours trained on the training clips."""
        if self.sources.extractor is not None:
            return SkeletonConvolution.load(self.sources.extractor)
        folder = self.folder / "extractor"
        config = SkeletonConvolutionConfig()
        training = SkeletonConvolutionTraining(steps=EXTRACTOR_STEPS[self.scale.name], seed=self.seed)

        def make() -> None:
            names = self.corpus.names("train", has_mirrored=False)
            clips = [extractor_input(torch.from_numpy(self.corpus.motion(name).rotations)) for name in names]
            train_skeleton_convolution(
                config,
                training,
                clips,
                folder,
                device=self.device,
                card=self._card("extractor"),
                progress=self.progress,
            )

        self._make_once(folder, {"corpus": self._digest, "training": training.model_dump(mode="json")}, make)
        return SkeletonConvolution.load(folder)

    def motion(self, clip: Clip) -> Motion:
        """The motion of a clip on SMPL-X's joints."""
        return Motion(self.corpus.skeleton, clip.rotations, clip.root, float(FRAME_RATE_HZ))

    def positions(self, motion: Motion) -> Float[torch.Tensor, "t 55 3"]:
        """Joint positions in metres with the root at the origin, as EMAGE measures them, on the body of the set."""
        at_origin = Motion(motion.skeleton, motion.rotations, motion.root * 0, motion.fps).pose().positions
        return at_origin - at_origin[:, :1]

    def _generate(self, name: str, tokenizer: BodyTokenizer, generator: Generator, sounds: Sounds) -> list[Motion]:
        return decoded_motion(self.codec, tokenizer, generator, sounds, device=self.device, progress=self.progress)

    def _prepared(self, copy: Path) -> Path:
        folder = self.folder / "set"

        def make() -> None:
            survey = survey_of("beat2", copy, speakers=SPEAKERS)
            done = prepare("beat2", survey, folder, OPTIONS, workers=self.workers, progress=self.progress)
            for name, why in done.failures:
                self.say(f"  left out {name}: {why}")

        self._make_once(folder, {"copy": copy.name, "speakers": SPEAKERS, "options": OPTIONS.binding()}, make)
        return folder

    def _sample(self) -> Path:
        """Make a synthetic copy of the dataset."""
        from echoavatar_lab.corpora.rehearsal.corpus import Plan, rehearse

        if not self.scale.hours:
            raise EchoAvatarError(
                f"scale {self.scale.name} needs your copy of BEAT2: give beat_english_v2.0.0, or a set made by"
                " `echoavatar data prepare beat2 --rig native --fingers keep` (--corpus)"
            )
        seconds = max(self.scale.clip_seconds, LEAST_SECONDS)
        hours = max(self.scale.hours, LEAST_CLIPS * seconds / 3600)
        plan = Plan(hours, self.seed + 1, self.folder / "rehearsed", clip_seconds=seconds)
        copy = self.folder / "copy"

        def make() -> None:
            rehearse(plan, workers=self.workers, progress=self.progress)
            write_sample(Corpus(plan.folder), copy)

        self._make_once(copy, {"hours": hours, "seed": plan.seed, "clip_seconds": seconds}, make)
        return copy
