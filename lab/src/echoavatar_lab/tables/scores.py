"""Scores of one line of a table over the test clips, with intervals over clips.

Generated motion is scored by `evaluation.score`. Reconstructed motion gets the paper's three scores: FID; MPJPE over
all joints, relative to the body; and the error of the root's steps. The last two are in 1e-4 m.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar_lab.data import Clip
from echoavatar_lab.evaluation.measures import Extractor, latent_moments
from echoavatar_lab.evaluation.metrics.distributions import Moments
from echoavatar_lab.evaluation.metrics.positions import PAPER_UNIT_M, centred, mean_distance
from echoavatar_lab.evaluation.motion_folder import Pair
from echoavatar_lab.evaluation.report import fid_row, score
from echoavatar_lab.evaluation.table import Row, row_of_means
from echoavatar_lab.kinematics import from_features, quaternion_from_matrix
from echoavatar_lab.models.generator.losses import nll_by_domain
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import whole_features

from .experiment import Experiment
from .scale import GeneratorChoice, Variant
from .table import Cell, Column, Line, Wanted, cells

GENERATION = {
    "fid": Wanted("fid"),
    "diversity": Wanted("l1_diversity"),
    "ba_g": Wanted("ba_g_paper", 10.0),
    "ba_g_over": Wanted("ba_g_paper", 10.0, "excess"),
    "ba_d": Wanted("ba_d_paper", 10.0),
    "ba_d_over": Wanted("ba_d_paper", 10.0, "excess"),
}
"""Columns for generated motion. Beat alignment is in tenths, as in the paper; `_over` is its excess over chance, which
is what the same motion scores with the sound of other clips."""
GENERATION_COLUMNS = (
    Column("fid", "FID"),
    Column("diversity", "Diversity", better="higher"),
    Column("ba_g", "BA_G", "1/10", better="higher"),
    Column("ba_g_over", "BA_G over chance", "1/10", better="higher"),
    Column("ba_d", "BA_D", "1/10", better="higher"),
    Column("ba_d_over", "BA_D over chance", "1/10", better="higher"),
)
LISTENING = Column("listening", "Another's sound costs", "nats a code", better="higher")


def papers(fid: float, *rest: float) -> dict[str, float]:
    """The paper's FID, diversity, BA_G and BA_D of a line by column; the last ones may be missing."""
    return dict(zip(("fid", "diversity", "ba_g", "ba_d"), (fid, *rest), strict=False))


def reconstruction_scores(
    tokenizer: BodyTokenizer, clips: Sequence[Clip], extractor: Extractor, *, seed: int = 0
) -> dict[str, Cell]:
    """`fid`, `mpjpe` and `trans` of clips that were encoded and decoded as streams."""
    made: list[Moments] = []
    true: list[Moments] = []
    errors, steps, weights = [], [], []
    for clip in clips:
        truth = whole_features(tokenizer.skeleton, clip)
        again = tokenizer.decode(tokenizer.encode(truth[None]))[0]
        sides = [from_features(tokenizer.skeleton, features) for features in (again, truth)]
        errors.append(mean_distance(*(centred(HUMANOID, side.rotations) for side in sides)) / PAPER_UNIT_M)
        start = travel_slice(tokenizer.skeleton).start
        moved, wanted = (features[:, start : start + 2] for features in (again, truth))
        steps.append(mean_distance(moved, wanted) / PAPER_UNIT_M)
        weights.append(float(len(truth)))
        for side, found in zip(sides, (made, true), strict=True):
            found.append(latent_moments(extractor, quaternion_from_matrix(side.rotations), side.root))
    share = np.array(weights)
    rows = [
        fid_row(made, true, seed=seed),
        row_of_means("mpjpe", "1e-4 m", np.array(errors), weights=share, seed=seed),
        row_of_means("trans", "1e-4 m", np.array(steps), weights=share, seed=seed),
    ]
    return cells(rows, {row.name: Wanted(row.name) for row in rows})


def generation_scores(
    motions: Sequence[Motion], clips: Sequence[Clip], extractor: Extractor, *, seed: int = 0
) -> list[Row]:
    """All scores of generated motion against the clips whose sound it was generated from, over what both have."""
    pairs = [_pair(motion, clip) for motion, clip in zip(motions, clips, strict=True)]
    return score(pairs, extractor, seed=seed)


def generation_cells(
    experiment: Experiment,
    motions: Sequence[Motion],
    wanted: Mapping[str, Wanted] = GENERATION,
    chosen: Sequence[int] | None = None,
) -> dict[str, Cell]:
    """Cells of motion for the test clips, or for the `chosen` ones of them by index."""
    at = range(len(experiment.test_clips)) if chosen is None else chosen
    made, clips = [motions[number] for number in at], [experiment.test_clips[number] for number in at]
    return cells(generation_scores(made, clips, experiment.extractor, seed=experiment.seed), wanted)


def generated_line(experiment: Experiment, variant: Variant) -> Line:
    """The line of one of our generators, which is trained where it is missing."""
    experiment.say(f"line: {variant.name}")
    motions = experiment.generated_motions(variant.generator)
    cells = generation_cells(experiment, motions) | {LISTENING.key: listening(experiment, variant.generator)}
    return Line(variant.name, variant.paper, cells)


def listening(experiment: Experiment, choice: GeneratorChoice) -> Cell:
    """By how many nats a code the true motion of the test clips surprises more beside the next clip's sound.

    A generator that ignores its sound scores 0. The interval is over clips.
    """
    generator, coded = experiment.generator(choice), experiment.codes(choice.tokenizer, experiment.test_clips)
    costs = []
    for clip, other in zip(coded, [*coded[1:], coded[0]], strict=True):
        deceived = dataclasses.replace(clip, audio=np.resize(other.audio, clip.audio.shape))
        own, wrong = (nll_by_domain(generator, [one])["all"] for one in (clip, deceived))
        costs.append(wrong - own)
    row = row_of_means(LISTENING.key, LISTENING.unit, np.array(costs), seed=experiment.seed)
    return Cell(row.value, *row.interval)


def _pair(motion: Motion, clip: Clip) -> Pair:
    frames = min(motion.frames, clip.frames)
    audio, domain = clip.audio[: frames * SAMPLES_PER_FRAME], clip.domain[:frames]
    return Pair(clip.name, motion.cut(0, frames), clip.motion().cut(0, frames), audio, domain)
