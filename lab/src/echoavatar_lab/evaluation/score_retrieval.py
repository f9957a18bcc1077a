"""Retrieval of motion by audio and back, among all pairs and in one gallery of 300, with chance and intervals."""

import zipfile
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.formats.tables import NpzArrays

from .metrics.bootstrap import Interval, interval, mean_interval
from .metrics.retrieval import PAPER_GALLERY, chance, ranks, similarity
from .score_row import Row

SHOWN_KS = (1, 5, 10)
_SAMPLES = 1000


def read_embeddings(path: Path) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n d"]]:
    """Arrays `audio` and `motion` of an `.npz`, one pair a row.

    Raises:
        EchoAvatarError: missing, damaged, of different shapes, or not finite.
    """
    try:
        with NpzArrays(path) as stored:
            audio, motion = stored["audio"], stored["motion"]
    except FileNotFoundError as error:
        raise EchoAvatarError(f"{path} does not exist; check the name") from error
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise EchoAvatarError(f"{path} holds no arrays `audio` and `motion`; write them with np.savez") from error
    if audio.shape != motion.shape or audio.ndim != 2 or len(audio) < 2:
        raise EchoAvatarError(
            f"{path}: audio {audio.shape} and motion {motion.shape} must both be (pairs, size), two pairs or more"
        )
    if not (np.isfinite(audio).all() and np.isfinite(motion).all()):
        raise EchoAvatarError(f"{path} holds values that are not finite; make the embeddings again")
    return audio, motion


def retrieval_rows(audio: Float[np.ndarray, "n d"], motion: Float[np.ndarray, "n d"], *, seed: int = 0) -> list[Row]:
    """R@K and MRR in percent, MedR in ranks; `a2m` queries motion with audio. Intervals are over queries."""
    every = similarity(audio, motion)
    rows = _rows(every, "all", seed)
    if len(every) > PAPER_GALLERY:
        chosen = np.random.default_rng(seed).permutation(len(every))[:PAPER_GALLERY]
        rows += _rows(every[np.ix_(chosen, chosen)], str(PAPER_GALLERY), seed)
    return rows


def _rows(matrix: Float[np.ndarray, "n n"], gallery: str, seed: int) -> list[Row]:
    rows, guess = [], chance(len(matrix), SHOWN_KS)
    for way, similarities in (("a2m", matrix), ("m2a", matrix.T)):
        rank = ranks(similarities)
        for k in SHOWN_KS:
            rows.append(_mean_row(f"{way}_r{k}_{gallery}", (rank < k) * 100.0, guess.recall[k], seed))
        middle = _median_rank(rank, np.arange(len(rank)))
        ends = interval(partial(_median_rank, rank), len(rank), samples=_SAMPLES, seed=seed)
        rows.append(Row(f"{way}_medr_{gallery}", "rank", middle, ends, guess.median_rank, middle - guess.median_rank))
        rows.append(_mean_row(f"{way}_mrr_{gallery}", 100 / (rank + 1), guess.reciprocal_rank, seed))
    return rows


def _median_rank(rank: Float[np.ndarray, " n"], queries: Int[np.ndarray, " k"]) -> float:
    return float(np.median(rank[queries])) + 1


def _mean_row(name: str, values: Float[np.ndarray, " n"], guess: float, seed: int) -> Row:
    ends = mean_interval(values, samples=_SAMPLES, seed=seed)
    over = Interval(ends.low - guess, ends.high - guess)
    value = float(values.mean())
    return Row(name, "%", value, ends, guess, value - guess, over)
