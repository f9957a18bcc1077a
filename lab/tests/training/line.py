"""A stage of four weights, with everything a stage can have: an average beside the state dict, state, measurements."""

from pathlib import Path

import torch
from torch import Tensor, nn

from echoavatar_lab import checkpoint
from echoavatar_lab.training import Gather, Loss, TrainingConfig, TrainingTask

CONFIG = TrainingConfig(steps=12, batch=8, learning_rate=0.05, warmup=2, save_every=3)


class Mean(nn.Module):
    """Remembers the mean of what it is told, beside its state dict."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("value", torch.zeros(()), persistent=False)

    def training_state(self) -> dict[str, Tensor]:
        return {"value": self.value}


class Line(TrainingTask[tuple[Tensor, Tensor]]):
    """Learns y = 2 x + 1 from noisy points; the noise is of torch's global generator, as rollouts would be."""

    def __init__(self, config: TrainingConfig = CONFIG, hidden: int = 2) -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            layers = nn.ModuleList([nn.Linear(1, hidden), nn.Linear(hidden, 1)])
        super().__init__(config, {"layers": layers, "mean": Mean()})
        self.seen = torch.zeros(())

    def draw(self, step: int) -> tuple[Tensor, Tensor]:
        x = torch.randn(self.config.batch, 1, generator=self.config.noise(step))
        return x, 2 * x + 1 + 0.1 * torch.randn(self.config.batch, 1)

    def loss(self, batch: tuple[Tensor, Tensor], step: int) -> Loss:
        x, y = batch
        for layer in self.modules["layers"]:
            x = layer(x)
        error = (x - y).square().mean()
        self.last = y.mean().detach()
        return Loss(error, {"error": error, "x": x.mean()})

    def after(self, step: int, gather: Gather) -> None:
        mean = gather(self.last[None]).mean()
        self.modules["mean"].value.lerp_(mean, 0.1)
        self.seen += 1

    def evaluate(self) -> dict[str, float]:
        return {"held_out": 1.0}

    def state(self) -> dict[str, Tensor]:
        return {"seen": self.seen}

    def load_state(self, state: dict[str, Tensor]) -> None:
        self.seen = state["seen"]

    def save(self, folder: Path, step: int) -> None:
        weights = self.modules["layers"].state_dict()
        checkpoint.save(folder, config=self.config, weights=weights, card={"step": step})


def weights(stage: Line) -> Tensor:
    """All of them as one row."""
    return torch.cat([p.detach().flatten() for p in stage.modules["layers"].parameters()])
