from dataclasses import astuple

import numpy as np
import torch

from echoavatar.models.generator.manner import MANNER, Manner, MannerControl, draw_manner


def test_manners_fill_their_range_and_follow_from_the_seed():
    assert draw_manner(4) == draw_manner(4)
    drawn = np.array([astuple(draw_manner(seed)) for seed in range(300)])
    assert drawn.min() >= 0
    assert drawn.max() <= 1
    assert np.ptp(drawn, axis=0).min() > 0.7
    right = drawn[:, MANNER.index("right")]
    assert 0.1 < (right < 0.5).mean() < 0.35


def test_what_is_not_told_adds_nothing_and_each_number_has_its_own_effect():
    control = MannerControl(16)
    torch.nn.init.normal_(control.proj.weight)
    told = torch.tensor([Manner().values])
    nothing = torch.full_like(told, torch.nan)
    assert not control.hint(nothing).any()
    one_by_one = [torch.where(torch.arange(len(MANNER)) == k, told, torch.nan) for k in range(len(MANNER))]
    assert torch.allclose(sum(control.hint(each) for each in one_by_one), control.hint(told), atol=1e-5)


def test_the_effect_changes_steadily_with_a_number():
    control = MannerControl(16)
    torch.nn.init.normal_(control.proj.weight)
    told = torch.tensor([Manner().values]).repeat(101, 1)
    told[:, MANNER.index("liveliness")] = torch.linspace(0, 1, 101)
    steps = control.hint(told).diff(dim=0).norm(dim=1)
    assert steps.min() > 0
    assert steps.max() < 1
