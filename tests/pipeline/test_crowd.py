"""A large batch against its sessions one by one, which take the stages one after the other."""

import pytest
import torch
from tests.pipeline.test_post import flat, gestures

from echoavatar.kinematics import HUMANOID
from echoavatar.pipeline.crowd import MANY
from echoavatar.pipeline.modes import MotionOptions
from echoavatar.pipeline.post import Post


@pytest.mark.parametrize("leash", [0.0, 1.0])
def test_a_crowd_is_its_sessions_one_by_one_to_the_bit(leash: float) -> None:
    rows = 2 * MANY + 3
    features = gestures(rows, 24, torch.Generator().manual_seed(3))
    active = torch.arange(rows) % 5 != 1
    crowd, alone = Post(HUMANOID), Post(HUMANOID)
    state, states = crowd.init_state(rows), [alone.init_state(1) for _ in range(rows)]
    state.modes.choose(torch.arange(rows) == 7, MotionOptions(leash_m=leash))
    states[7].modes.choose(torch.tensor([True]), MotionOptions(leash_m=leash))
    for part in torch.split(features, 8, 1):
        together = flat(crowd.step(part, state, active))
        for row in range(rows):
            one = alone.step(part[row : row + 1], states[row], active[row : row + 1])
            assert (flat(one)[0] == together[row]).all()
    if leash:
        return  # stages that only leashed rows need then remember the free ones, too
    for ours, theirs in zip(state.tensors(), zip(*(s.tensors() for s in states), strict=True), strict=True):
        assert torch.equal(ours, torch.cat(theirs))


def test_rotations_that_are_none_are_repaired_in_a_crowd_as_alone() -> None:
    rows = 2 * MANY
    features = gestures(rows, 16, torch.Generator().manual_seed(4))
    features[3, 2], features[20, 12] = torch.nan, torch.nan
    crowd, alone, everyone = Post(HUMANOID), Post(HUMANOID), torch.ones(rows, dtype=torch.bool)
    state, states = crowd.init_state(rows), alone.init_state(rows)
    for part in torch.split(features, 8, 1):
        together, staged = (
            post.step(part, kept, everyone, lap)
            for post, kept, lap in ((crowd, state, None), (alone, states, lambda stage: None))
        )
        assert (flat(together) == flat(staged)).all()
    assert crowd.repaired == alone.repaired > 0
