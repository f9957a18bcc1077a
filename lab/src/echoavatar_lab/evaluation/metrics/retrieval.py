"""Retrieval: does audio find its own motion among others (paper, appendix Audio-Motion Reward; after TMR)?

The input is a similarity matrix of n audio clips and their n motions in the same order.

- rank (0 is best): number of other motions that are more similar; ties count half;
- R@K: percentage of queries with rank below K; MedR: median rank + 1; MRR: mean of 1 / (rank + 1), in percent.

Chance is K/n, (n + 1)/2 and H(n)/n. Galleries: all pairs; one random gallery of 300 (the paper's "small batches": all
its entries are multiples of 1/300); or batches of 32 averaged, the last incomplete one dropped (TMR's own protocol).
Overlapping windows of one recording are near copies and blur the ranks: use windows that do not overlap.

`style_consistency` is MDSC's ratio (Zhou et al., 2023, arXiv 2309.01340: does a dance have the style of its music?) on
any joint embedding: the distance of dances from music of other styles over that from music of their own. MDSC's own
encoders were announced and not published, so only values of one embedding compare.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from echoavatar.errors import EchoAvatarError

PAPER_GALLERY = 300
TMR_BATCH = 32
KS = (1, 2, 3, 5, 10)


class Retrieval(NamedTuple):
    """Scores of one direction."""

    recall: dict[int, float]  # percent, by K
    median_rank: float
    reciprocal_rank: float  # percent
    gallery: int


def similarity(sounds: Float[np.ndarray, "n d"], motions: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n n"]:
    """Inner products in double precision, rounded so that equal embeddings tie in any order of summation."""
    return np.asarray(np.round(sounds.astype(np.float64) @ motions.astype(np.float64).T, 9))


def ranks(similarities: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " n"]:
    """Rank of each row's correct answer, the diagonal; transpose for the other direction."""
    right = np.diag(similarities)[:, None]
    better, equal = (similarities > right).sum(1), (similarities == right).sum(1)
    return np.asarray(better + (equal - 1) / 2)


def retrieval(similarities: Float[np.ndarray, "n n"], ks: tuple[int, ...] = KS) -> Retrieval:
    """Scores with rows as queries and columns as answers."""
    rank = ranks(similarities)
    recall = {k: float((rank < k).mean() * 100) for k in ks}
    return Retrieval(recall, float(np.median(rank) + 1), float((1 / (rank + 1)).mean() * 100), len(rank))


def gallery(similarities: Float[np.ndarray, "n n"], *, seed: int = 0) -> Retrieval:
    """Scores in one random gallery of 300 pairs (all, if there are fewer)."""
    chosen = np.random.default_rng(seed).permutation(len(similarities))[:PAPER_GALLERY]
    return retrieval(similarities[np.ix_(chosen, chosen)])


def tmr_batches(pairs: int) -> list[Int[np.ndarray, " b"]]:
    """TMR's batches: one shuffle of seed 0 with NumPy's legacy generator, cut into full batches."""
    order = np.random.RandomState(0).permutation(pairs)
    return [order[at : at + TMR_BATCH] for at in range(0, pairs - TMR_BATCH + 1, TMR_BATCH)]


def batched(similarities: Float[np.ndarray, "n n"]) -> Retrieval:
    """Mean scores over TMR's batches."""
    parts = [retrieval(similarities[np.ix_(b, b)]) for b in tmr_batches(len(similarities))]
    recall = {k: float(np.mean([part.recall[k] for part in parts])) for k in KS}
    median, reciprocal = (float(np.mean([part[field] for part in parts])) for field in (1, 2))
    return Retrieval(recall, median, reciprocal, TMR_BATCH)


def chance(pairs: int, ks: tuple[int, ...] = KS) -> Retrieval:
    """Scores of random guessing."""
    harmonic = float((1 / np.arange(1, pairs + 1)).sum())
    return Retrieval({k: min(100.0, 100 * k / pairs) for k in ks}, (pairs + 1) / 2, 100 * harmonic / pairs, pairs)


class Consistency(NamedTuple):
    """Distances of dances from their own style's music and from that of others; a `ratio` of 1 is chance."""

    intra: float
    inter: float
    ratio: float


def style_consistency(
    sounds: Float[np.ndarray, "n d"], motions: Float[np.ndarray, "m d"], styles: Sequence[str], of: Sequence[str]
) -> Consistency:
    """Mean Euclidean distances of motions (of these styles: `of`) from the mean of each style's sounds (`styles`).

    Raises:
        EchoAvatarError: fewer than two styles, or a motion of a style without music.
    """
    names = sorted(set(styles))
    if len(names) < 2 or not set(of) <= set(names):
        raise EchoAvatarError(f"style consistency needs music of two styles and of every dance's style, got {names}")
    middles = np.stack([np.mean([x for x, s in zip(sounds, styles, strict=True) if s == name], 0) for name in names])
    apart = np.linalg.norm(motions[:, None].astype(np.float64) - middles, axis=-1)
    own = np.array(of)[:, None] == np.array(names)
    intra, inter = float(apart[own].mean()), float(apart[~own].mean())
    return Consistency(intra, inter, inter / max(intra, 1e-12))
