import numpy as np
from tests.evaluation.metrics.swings import swing

from echoavatar.evaluation.metrics.beat_alignment import mean_hit_rate
from echoavatar.evaluation.metrics.chance import chance_per_clip, mean_of_known, shuffled_scores
from echoavatar.evaluation.metrics.gesture_alignment import gesture_beats


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


def test_what_cannot_be_scored_is_left_out() -> None:
    scores = shuffled_scores(lambda i, j: float("nan") if j == 0 else float(j), 3)
    np.testing.assert_allclose(chance_per_clip(scores), [1.5, 2.0, 1.0])
    assert mean_of_known(scores) == 1.5
    assert np.isnan(mean_of_known(shuffled_scores(lambda i, j: 1.0, 1)))


def test_chance_is_below_the_score_of_aligned_motion() -> None:
    periods = (0.9, 1.1, 1.3)
    events = [np.arange(1, 12) * period / 2 for period in periods]
    beats = [gesture_beats(swing(period)) for period in periods]
    own = [mean_hit_rate(events[i], beats[i], 0.06) for i in range(3)]
    chance = shuffled_scores(lambda i, j: mean_hit_rate(events[j], beats[i], 0.06), 3)
    assert min(own) > 0.9
    assert mean_of_known(chance) < 0.6
