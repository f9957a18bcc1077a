import numpy as np
import pytest

from echoavatar_lab.corpora.dance.dance_plan import DancePlan, compose_dance
from echoavatar_lab.corpora.dance.footwork import PLACES
from echoavatar_lab.corpora.dance.grooves import find_counts

from .test_grooves import music


def planned(bpm: float = 120, seed: int = 0, metre: int = 4, style: str = "house") -> DancePlan:
    track = music(bpm, metre=metre, style=style, seconds=32)
    return compose_dance(find_counts(track, track.spans[0]), np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(4))
def test_steps_land_on_counts(seed: int) -> None:
    plan = planned(seed=seed)
    landings = np.array([h.landing for h in plan.holds if h.lift_off < plan.settle])
    grid = plan.counts.times[:, None] + np.array([0.0, 0.25])  # counts and the ball of a kick-ball-change
    assert np.abs(landings[:, None] - grid.ravel()).min(1).max() < 0.02


@pytest.mark.parametrize("seed", range(4))
def test_one_foot_swings_at_a_time_and_feet_come_home(seed: int) -> None:
    plan = planned(seed=seed)
    for before, after in zip(plan.holds, plan.holds[1:], strict=False):
        assert after.lift_off >= before.landing
    last = {hold.side: hold for hold in plan.holds}
    for side, hold in last.items():
        assert hold.place == PLACES[side]
        assert hold.pitch == 0.0
    assert max(hold.landing for hold in plan.holds) < plan.settle + 1.3


def test_phrases_change_on_bars_and_come_back() -> None:
    plan = planned(bpm=120, seed=3)
    starts = [np.abs(plan.counts.times - time).argmin() for time, _, _ in plan.names]
    assert all(start % 4 == 0 for start in starts)
    loud = [figure for time, figure, _ in plan.names if time >= 9.0]
    assert loud[0] == loud[1]  # A A
    assert loud[0] != loud[2]  # B
    assert loud[0] == loud[3]  # A'


def test_the_dancer_listens_before_the_first_step() -> None:
    plan = planned()
    assert plan.names[0][1] == "bounce"
    assert plan.holds[0].lift_off > plan.begin + 1.0


def test_dancers_differ_and_a_dancer_repeats() -> None:
    assert planned(seed=1).names == planned(seed=1).names
    assert len({tuple(planned(seed=s).names) for s in range(4)}) > 1
