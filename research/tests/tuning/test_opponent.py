"""The opponent learns what the policy does now."""

import numpy as np

from echoavatar_research.tuning.opponent import Opponent


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
