"""The paper's table "Comparison with the state-of-the-art methods on BEAT2", with EMAGE's measures.

The measures are FID with EMAGE's skeleton convolutions, beat alignment with EMAGE's index quirk, and L1 diversity.
All are taken on SMPL-X's 55 joints with the root at the origin, from motion as it leaves the decoder.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import torch

from echoavatar.motion.kinematics import Motion
from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar_lab.data import SPEECH
from echoavatar_lab.evaluation.beat_rows import ClipAudio, gesture_rows
from echoavatar_lab.evaluation.metrics.beat_alignment import SMPLX_UPPER_BODY
from echoavatar_lab.evaluation.metrics.distributions import Moments, moments
from echoavatar_lab.evaluation.metrics.positions import l1_deviation
from echoavatar_lab.evaluation.report import fid_row
from echoavatar_lab.evaluation.table import Row, row_of_means
from echoavatar_lab.tables.baselines import Baselines, Kind

from .beat2_experiment import Beat2Experiment
from .choices import OURS, GeneratorChoice
from .main import foreign_notes
from .skeleton_convolution import extractor_input
from .table import Cell, Column, Line, Table, Wanted, cells
from .waves import Part, generator_waves

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
BASELINES: dict[str, Kind] = {"Mean pose": "mean", "Random clip": "random", "Nearest sound": "nearest"}


def waves(experiment: Beat2Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `waves`."""
    _ = experiment.extractor
    return generator_waves([GeneratorChoice(OURS.name)])


def make(experiment: Beat2Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    keys = ("fid", "ba_g", "diversity")
    others = experiment.foreign_motions()  # first: a bad file must be told before hours of training
    truth = [experiment.motion(clip) for clip in experiment.test_clips]
    line = partial(_line, experiment)
    published = {name: dict(zip(keys, values, strict=True)) for name, values in QUOTED.items()}
    ours = {name.lower(): name for name in others}
    lines = [Line(f"{name} (quoted)", values) for name, values in published.items() if name.lower() not in ours]
    rows = scored(experiment, truth)
    lines.append(Line("Real motion", {}, cells(rows, SCORES)))
    lines.append(Line("Real motion, one half against the other", {}, _halves(rows)))
    baselines = Baselines(experiment.train_clips, experiment.corpus.skeleton)
    for name, kind in BASELINES.items():
        sounds = enumerate(experiment.test_clips, experiment.seed)
        lines.append(line(name, [baselines.make(kind, clip.audio, seed=seed) for seed, clip in sounds]))
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
    true = [experiment.motion(clip).cut(0, stop) for clip, stop in zip(clips, frames, strict=True)]
    places, truths = (
        [experiment.positions(motion).numpy().astype(np.float64) for motion in side] for side in (made, true)
    )
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
