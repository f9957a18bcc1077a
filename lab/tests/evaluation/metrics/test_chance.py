import numpy as np

from echoavatar_lab.evaluation.metrics.chance import chance_per_clip, mean_of_known, shuffled_scores


def test_each_motion_meets_every_other_sound_once_and_never_its_own() -> None:
    met: list[tuple[int, int]] = []

    def score(motion: int, sound: int) -> float:
        met.append((motion, sound))
        return 0.0

    assert shuffled_scores(score, 4).shape == (4, 3)
    assert sorted(met) == [(i, j) for i in range(4) for j in range(4) if i != j]


def test_fewer_partners_are_drawn_by_the_seed() -> None:
    scores = [shuffled_scores(lambda i, j: 10 * i + j, 9, partners=3, seed=seed) for seed in (1, 1, 2)]
    assert scores[0].shape == (9, 3)
    assert all(len(set(row)) == 3 for row in scores[0])
    assert all(int(value) % 10 != i for i, row in enumerate(scores[0]) for value in row)
    np.testing.assert_array_equal(scores[0], scores[1])
    assert not np.array_equal(scores[0], scores[2])


def test_clips_that_cannot_be_scored_are_left_out() -> None:
    scores = shuffled_scores(lambda i, j: float("nan") if j == 0 else float(j), 3)
    np.testing.assert_allclose(chance_per_clip(scores), [1.5, 2.0, 1.0])
    assert mean_of_known(scores) == 1.5
    assert np.isnan(mean_of_known(shuffled_scores(lambda i, j: 1.0, 1)))
