import numpy as np
import pytest

from echoavatar_lab.evaluation.metrics import retrieval

MATRIX = np.array([[0.9, 0.1, 0.2], [0.8, 0.5, 0.1], [0.3, 0.3, 0.3]])


def test_ranks_count_the_better_and_half_of_the_equal() -> None:
    """Row 0 first; row 1 second; row 2 ties with both others: (3 - 1) / 2."""
    assert retrieval.ranks(MATRIX).tolist() == [0, 1, 1]


def test_scores_follow_from_ranks() -> None:
    scores = retrieval.retrieval(MATRIX)
    assert scores.recall[1] == pytest.approx(100 / 3)
    assert scores.recall[2] == 100
    assert scores.median_rank == 2
    assert scores.reciprocal_rank == pytest.approx(100 * (1 + 0.5 + 0.5) / 3)


def test_embeddings_that_belong_together_are_found() -> None:
    random = np.random.default_rng(0)
    sounds = random.normal(size=(400, 16))
    sounds /= np.linalg.norm(sounds, axis=1, keepdims=True)
    similar = retrieval.similarity(sounds, sounds + 0.03 * random.normal(size=sounds.shape))
    assert retrieval.retrieval(similar).recall[1] > 95
    assert retrieval.gallery(similar).gallery == 300
    assert retrieval.gallery(similar[:50, :50]).gallery == 50
    assert retrieval.batched(similar).gallery == 32


def test_guessing_scores_chance() -> None:
    """300 pairs: 0.33 % at one, median 150.5, MRR H(300)/300 = 2.09 %, as the paper's random row says."""
    chance = retrieval.chance(300)
    assert chance.recall[1] == pytest.approx(100 / 300)
    assert chance.reciprocal_rank == pytest.approx(2.094, abs=1e-3)
    noise = np.random.default_rng(1).normal(size=(300, 300))
    guessed = retrieval.retrieval(noise)
    assert guessed.median_rank == pytest.approx(chance.median_rank, rel=0.15)
    assert guessed.recall[10] == pytest.approx(chance.recall[10], abs=3)
