import torch

from echoavatar_lab.nn.stream import write_rows


def test_idle_rows_are_not_written() -> None:
    target = torch.zeros(2, 3)
    write_rows(target, torch.ones(2, 3), torch.tensor([False, True]))
    assert torch.equal(target, torch.tensor([[0.0] * 3, [1.0] * 3]))
