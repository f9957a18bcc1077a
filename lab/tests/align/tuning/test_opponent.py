"""The opponent learns what the policy does now."""

import numpy as np

from echoavatar_lab.align.tuning.opponent import Opponent


def test_the_opponent_follows_the_policy() -> None:
    random = np.random.default_rng(0)

    def windows(middle: float) -> np.ndarray:
        return middle + random.standard_normal((200, 9))

    opponent = Opponent(windows(0.0))
    assert opponent.see(windows(2.0)) is None  # nothing learnt yet
    assert opponent.see(windows(2.0)) > 0.95
    assert opponent.odds(windows(2.0)).mean() < -2 < 2 < opponent.odds(windows(0.0)).mean()
    assert np.abs(opponent.odds(windows(50.0))).max() <= 4
    for _ in range(12):
        last = opponent.see(windows(0.0))
    assert last < 0.65  # the policy moves as people do now


def test_it_goes_on_where_its_state_was_taken() -> None:
    random = np.random.default_rng(0)
    batches, people = random.standard_normal((5, 40, 9)), random.standard_normal((40, 9)) + 1
    first, second = Opponent(people), Opponent(people)
    for batch in batches[:4]:
        first.see(batch)
    second.load_state(first.state())
    assert second.see(batches[4]) == first.see(batches[4])
    np.testing.assert_array_equal(second.odds(people), first.odds(people))
    assert first.odds(people).any()
