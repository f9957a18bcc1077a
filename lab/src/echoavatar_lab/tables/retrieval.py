"""The paper's table "Retrieval ability of the audio-motion contrastive space": does sound find its own motion?

The alignment reward is trained on the training clips and asked about windows of the other clips that do not overlap.
The paper has galleries of 1,808 and 300 windows; ours are as large as the held-out clips allow, and their size is
told. Its "small batches" are one gallery of 300: all their entries are multiples of 1/300.
"""

from collections.abc import Sequence
from operator import methodcaller
from typing import NamedTuple

import numpy as np

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.align.audio_reward_train import AudioMotionWindows, embed
from echoavatar_lab.evaluation.metrics.retrieval import PAPER_GALLERY, Retrieval, chance, gallery, retrieval, similarity

from .alignment import alignment_reward, reward_window, token_clips
from .choices import OURS
from .experiment import Experiment
from .table import Cell, Column, Line, Table
from .waves import Part

NAME = "retrieval"
KS = (1, 3, 5, 10)
WAYS = {"a2m": "audio to motion", "m2a": "motion to audio"}
COLUMNS = tuple(
    column
    for way, told in WAYS.items()
    for column in (
        *(Column(f"{way}_r{k}", f"R@{k}, {told}", "%", better="higher") for k in KS),
        Column(f"{way}_medr", f"MedR, {told}"),
        Column(f"{way}_mrr", f"MRR, {told}", "%", better="higher"),
    )
)


class Quoted(NamedTuple):
    """A line of the paper: protocol, model, and R@1, 3, 5, 10, MedR, MRR in both directions."""

    name: str
    a2m: tuple[float, ...]
    m2a: tuple[float, ...]


QUOTED = (
    Quoted("All (1808), BEATs", (6.42, 10.51, 14.60, 21.79, 67.0, 11.07), (6.64, 10.51, 13.77, 18.75, 75.0, 10.70)),
    Quoted("All (1808), Wav2CLIP", (3.60, 6.58, 9.13, 13.05, 169.0, 7.00), (3.48, 5.86, 8.52, 12.06, 184.0, 6.57)),
    Quoted("All (1808), random", (0.06, 0.17, 0.28, 0.55, 904.0, 0.41), (0.06, 0.17, 0.28, 0.55, 904.0, 0.41)),
    Quoted("300, BEATs", (18.67, 27.33, 33.33, 44.00, 15.0, 26.49), (21.67, 30.00, 34.67, 44.00, 13.0, 28.37)),
    Quoted("300, Wav2CLIP", (9.00, 13.67, 17.67, 28.67, 23.5, 15.69), (6.33, 11.67, 16.00, 24.67, 37.5, 12.14)),
    Quoted("300, random", (0.33, 1.00, 1.67, 3.33, 150.0, 2.09), (0.33, 1.00, 1.67, 3.33, 150.0, 2.09)),
)


def waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `waves`."""
    return [[methodcaller("codes", OURS)], [_reward]]


def _reward(experiment: Experiment) -> None:
    alignment_reward(experiment, token_clips(experiment)[0])


def make(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    train_clips, held_out = token_clips(experiment)
    experiment.say("line: Ours")
    chunks = reward_window(train_clips)
    model = alignment_reward(experiment, train_clips)
    sounds, motions = embed(model, AudioMotionWindows(held_out, chunks=chunks))
    if len(sounds) < 2:
        raise EchoAvatarError(
            f"{experiment.corpus.folder} has {len(sounds)} held-out windows of {chunks} chunks; retrieval needs two:"
            " give a set with longer test clips"
        )
    toward, back = similarity(sounds, motions), similarity(motions, sounds)
    lines = [Line(f"{one.name} (quoted)", _paper(one)) for one in QUOTED]
    lines += _lines(f"all ({len(toward)})", retrieval(toward, KS), retrieval(back, KS))
    if len(toward) > PAPER_GALLERY:
        both = (_gallery(matrix, experiment.seed) for matrix in (toward, back))
        lines += _lines(f"{PAPER_GALLERY}", *both)
    notes = (
        f"Windows of {chunks} chunks of 0.267 s that do not overlap, of the clips that are not for training; the"
        " paper's windows are of 4 s.",
        "Our ears are the codec's codes, the paper's are BEATs and Wav2CLIP (`align reward-alignment` takes both).",
        "The paper's random MRR among 1,808 is 0.41 where H(1808)/1808 is 0.447.",
    )
    return Table(NAME, "Retrieval of audio and motion (paper, Audio-Motion Alignment Reward)", COLUMNS, lines, notes)


def _gallery(matrix: np.ndarray, seed: int) -> Retrieval:
    return gallery(matrix, PAPER_GALLERY, seed=seed)


def _lines(protocol: str, toward: Retrieval, back: Retrieval) -> list[Line]:
    guess = chance(toward.gallery, KS)
    return [
        Line(f"Ours, {protocol}", {}, _cells("a2m", toward) | _cells("m2a", back)),
        Line(f"Chance, {protocol}", {}, _cells("a2m", guess) | _cells("m2a", guess)),
    ]


def _cells(way: str, found: Retrieval) -> dict[str, Cell]:
    recalls = {f"{way}_r{k}": Cell(found.recall[k]) for k in KS}
    return recalls | {f"{way}_medr": Cell(found.median_rank), f"{way}_mrr": Cell(found.reciprocal_rank)}


def _paper(line: Quoted) -> dict[str, float]:
    kinds = [*(f"r{k}" for k in KS), "medr", "mrr"]
    sides = (("a2m", line.a2m), ("m2a", line.m2a))
    return {f"{way}_{kind}": value for way, values in sides for kind, value in zip(kinds, values, strict=True)}
