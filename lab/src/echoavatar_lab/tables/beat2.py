"""The paper's table "Comparison with the state-of-the-art methods on BEAT2", with EMAGE's measures.

The measures are FID with EMAGE's skeleton convolutions, beat alignment with EMAGE's index quirk, and L1 diversity.
All are taken on SMPL-X's 55 joints as recorded, with the root at the origin, from motion as it leaves the decoder.

Users without the dataset get a small folder in its layout: names, rates, npz keys and the split table are those of the
dataset, so `data prepare beat2` reads it like a real copy. Its motion is rehearsal motion written as SMPL-X and its
sound is synthetic, some of it music: no number from it says anything about BEAT2.
"""

import csv
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Self

import numpy as np
import soxr
import torch
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError
from echoavatar.files.exports.smplx import write_smplx
from echoavatar.files.exports.take import Take
from echoavatar.models.audio import write_wav
from echoavatar.motion.formats.smpl import skeleton
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import make_output_folder
from echoavatar_lab.data import SPEECH, Corpus
from echoavatar_lab.datasets import SetOptions, prepare, survey_of
from echoavatar_lab.datasets.layouts import BEAT2_SPLIT
from echoavatar_lab.evaluation.beat_rows import ClipAudio, gesture_rows
from echoavatar_lab.evaluation.metrics.beat_alignment import SMPLX_UPPER_BODY
from echoavatar_lab.evaluation.metrics.distributions import Moments, moments
from echoavatar_lab.evaluation.metrics.positions import l1_deviation
from echoavatar_lab.evaluation.report import fid_row
from echoavatar_lab.evaluation.table import Row, row_of_means
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.training import train

from .experiment import Experiment, Sources, want_test_clips
from .generate import Sounds, decoded_motion
from .main import foreign_notes
from .scale import OURS, GeneratorChoice, Part, ScaleName, generator_waves
from .skeleton_convolution import (
    SkeletonConvolution,
    SkeletonConvolutionConfig,
    SkeletonConvolutionTask,
    SkeletonConvolutionTraining,
    extractor_input,
)
from .table import Cell, Column, Line, Table, Wanted, cells

RATE_HZ = 16_000
TEST_EVERY = 8
SAMPLE_SPEAKER = "2_scott"


def write_sample(corpus: Corpus, folder: Path) -> Path:
    """Write every clip of a corpus on our rig as a recording of one speaker; return the folder for `data prepare`."""
    place = folder / "beat_english_v2.0.0"
    for name in ("smplxflame_30", "wave16k"):
        make_output_folder(place / name)
    rows = []
    for number, clip in enumerate(corpus.clips(), 1):
        name = f"{SAMPLE_SPEAKER}_0_{number}_{number}"
        write_smplx(place / "smplxflame_30" / f"{name}.npz", Take(clip.motion()))
        sound = soxr.resample(clip.audio, SAMPLE_RATE_HZ, RATE_HZ)
        write_wav(place / "wave16k" / f"{name}.wav", sound.astype(np.float32), rate=RATE_HZ)
        rows.append((name, "test" if number % TEST_EVERY == 0 else "train"))
    with (place / BEAT2_SPLIT).open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("id", "type"), *rows])
    return place


SPEAKERS = ("2",)  # the speaker of EMAGE's and MECo's tables; the paper does not name its own
OPTIONS = SetOptions(rig="native", fingers="keep")
EXTRACTOR_STEPS: dict[ScaleName, int] = {"tiny": 20, "rehearsal": 1500, "paper": 20_000}
LEAST_SECONDS = 8.0  # EMAGE's beat alignment cuts two seconds off both ends
LEAST_CLIPS = 24


class Beat2Experiment(Experiment):
    """All parts of the BEAT2 table, in a subfolder of their own."""

    @classmethod
    def of(cls, other: Experiment) -> Self:
        """A BEAT2 experiment with the sources and settings of another experiment."""
        return cls(other.folder / "beat2", other.scale, other.sources, **other._how() | {"runtime": "paper"})

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
            train(
                SkeletonConvolutionTask(config, training, clips, card=self._card("extractor")),
                folder,
                device=self.device,
                progress=self.progress,
            )

        self._make_once(folder, {"corpus": self._digest, "training": training.model_dump(mode="json")}, make)
        return SkeletonConvolution.load(folder)

    @property
    def rig(self) -> Skeleton:
        """SMPL-X's joints."""
        return self.corpus.skeleton

    def positions(self, motion: Motion) -> Float[np.ndarray, "t 55 3"]:
        """Joint positions in metres with the root at the origin, as EMAGE measures them, on the body of the set."""
        at_origin = Motion(motion.skeleton, motion.rotations, motion.root * 0, motion.fps).pose().positions
        places: np.ndarray = at_origin - at_origin[:, :1]
        return places

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


NAME = "beat2"
COLUMNS = (
    Column("fid", "FID", "1/10"),
    Column("ba_g", "BA_G", "1/10", better="higher"),
    Column("ba_g_over", "BA_G over chance", "1/10", better="higher"),
    Column("diversity", "Diversity", better="higher"),
)
SCORES = {
    "fid": Wanted("fid", 10.0),
    "ba_g": Wanted("ba_g_emage", 10.0),
    "ba_g_over": Wanted("ba_g_emage", 10.0, "excess"),
    "diversity": Wanted("l1_diversity"),
}
QUOTED = {
    "S2G": (28.15, 4.683, 5.971),
    "Trimodal": (12.41, 5.933, 7.724),
    "HA2G": (12.32, 6.779, 8.626),
    "DisCo": (9.417, 6.439, 9.912),
    "CaMN": (6.644, 6.769, 10.86),
    "DiffStyleGesture": (8.811, 7.241, 11.49),
    "Habibie et al.": (9.040, 7.716, 8.213),
    "TalkShow": (6.209, 6.947, 13.47),
    "EMAGE": (5.512, 7.724, 13.06),
    "SynTalker": (6.413, 7.971, 12.72),
    "MECo": (3.401, 7.346, 15.30),
    "ViBES": (5.257, 8.103, 13.03),
    "PersonaGesture": (3.930, 7.100, 13.25),
}
PAPER = (2.874, 7.342, 13.53)


def waves(experiment: Beat2Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `scale.generator_waves`."""
    _ = experiment.extractor
    return generator_waves([GeneratorChoice(OURS.name)])


def make(experiment: Beat2Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    keys = ("fid", "ba_g", "diversity")
    others = experiment.foreign_motions()  # first: a bad file must be told before hours of training
    line = partial(_line, experiment)
    published = {name: dict(zip(keys, values, strict=True)) for name, values in QUOTED.items()}
    ours = {name.lower(): name for name in others}
    lines = [Line(f"{name} (quoted)", values) for name, values in published.items() if name.lower() not in ours]
    rows = scored(experiment, experiment.true_motions)
    lines.append(Line("Real motion", {}, cells(rows, SCORES)))
    lines.append(Line("Real motion, one half against the other", {}, _halves(rows)))
    lines += [line(name, motions) for name, motions in experiment.baseline_motions()]
    quoted = {name.lower(): values for name, values in published.items()}
    lines += [line(name, motions, quoted.get(name.lower())) for name, motions in others.items()]
    choice = GeneratorChoice(OURS.name)
    lines.append(line("Ours", experiment.generated_motions(choice), dict(zip(keys, PAPER, strict=True))))
    notes = (*_notes(experiment), *foreign_notes(experiment, others))
    return Table(NAME, "BEAT2 (paper, Comparison with the state of the art)", COLUMNS, lines, notes)


def scored(experiment: Beat2Experiment, motions: Sequence[Motion]) -> list[Row]:
    """FID, all forms of BA_G, and L1 diversity of motion generated for the test clips."""
    clips, seed = experiment.test_clips, experiment.seed
    frames = [min(motion.frames, clip.frames) for motion, clip in zip(motions, clips, strict=True)]
    made = [motion.cut(0, stop) for motion, stop in zip(motions, frames, strict=True)]
    true = [motion.cut(0, stop) for motion, stop in zip(experiment.true_motions, frames, strict=True)]
    places, truths = ([experiment.positions(motion).astype(np.float64) for motion in side] for side in (made, true))
    latents, aims = ([_latents(experiment, motion) for motion in side] for side in (made, true))
    heard = [  # all of BEAT2 is speech
        ClipAudio(clip.audio[: stop * SAMPLES_PER_FRAME], np.full(stop, SPEECH))
        for clip, stop in zip(clips, frames, strict=True)
    ]
    lengths = np.array(frames, float)
    spread = np.array([l1_deviation(place) for place in places])
    return [
        fid_row(latents, aims, seed=seed),
        *gesture_rows(heard, places, truths, upper=SMPLX_UPPER_BODY, seed=seed),
        row_of_means("l1_diversity", "m", spread, weights=lengths, seed=seed),
    ]


def _line(
    experiment: Beat2Experiment, name: str, motions: Sequence[Motion], paper: dict[str, float] | None = None
) -> Line:
    experiment.say(f"line: {name}")
    return Line(name, paper or {}, cells(scored(experiment, motions), SCORES))


def _halves(rows: Sequence[Row]) -> dict[str, Cell]:
    """FID between test clips and other test clips: what motion of the same kind scores."""
    return cells(rows, {"fid": Wanted("fid", 10.0, "truth")})


def _latents(experiment: Beat2Experiment, motion: Motion) -> Moments:
    return moments(experiment.extractor.features(extractor_input(torch.from_numpy(motion.rotations))).numpy())


def _notes(experiment: Beat2Experiment) -> tuple[str, ...]:
    source = (
        "Without a copy of BEAT2: rehearsal motion in BEAT2's layout, made by rule, some of it to music. No number of"
        " ours in this table says anything about BEAT2."
        if experiment.is_synthetic
        else "Of BEAT2 speaker 2 is taken, as in EMAGE's and MECo's tables, unless a prepared set was given; the paper"
        " does not say of whom its numbers are."
    )
    given = experiment.sources.extractor
    extractor = (
        f"FID with the extractor in {given.name}, latents before its variational heads."
        if given is not None
        else "FID with an extractor of ours (EMAGE's network, trained on the training clips): not comparable with"
        " EMAGE's, whose weights are not shipped; give them with --extractor."
    )
    return (
        source,
        extractor,
        "BA_G is EMAGE's, index quirk and all, over the joints' mean speeds in the true test clips (EMAGE has a"
        " constant of its own). FID and BA_G times ten, as the paper prints them.",
        "Diversity: L1 deviation from the mean pose summed over 55 joints, metres, on a body of 1.70 m for whoever"
        " moved (`data prepare beat2 --body-model` takes the speaker's).",
        "Motion as it leaves the decoder: no foot, hand or floor correction, jaw and eyes as generated.",
    )
