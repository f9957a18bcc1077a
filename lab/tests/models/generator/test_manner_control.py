"""What is not told adds nothing, and a cleared control has no effect."""

import torch

from echoavatar.models.generator.manner import TOLD
from echoavatar_lab.models.generator.manner_control import MannerControl


def test_what_is_not_told_adds_nothing() -> None:
    control = MannerControl(width=8, read_width=6, codes=5)
    told = torch.full((2, len(TOLD)), 0.5)
    assert not control.hint(told).any()
    assert not control.likely(told).any()
    torch.nn.init.ones_(control.proj.weight)
    torch.nn.init.ones_(control.codes_proj.weight)
    assert control.hint(told).abs().min() > 0
    assert control.likely(told).abs().min() > 0
    silent = torch.full_like(told, torch.nan)
    assert not control.hint(silent).any()
    assert not control.likely(silent).any()
