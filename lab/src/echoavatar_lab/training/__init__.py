"""Training: one loop for every task, exactly resumable, in one process or several.

A task (`TrainingTask`) consists of a config, modules, data and a loss. The loop (`train`, or `Loop` step by step) does
the rest: schedule, accumulation, clipping, bfloat16, averaged weights, checkpoints, signals, metrics, processes.

    class Line(TrainingTask[Tensor]):
        def __init__(self, config: TrainingConfig) -> None:
            super().__init__(config, {"model": nn.Linear(1, 1)})

        def draw(self, step: int) -> Tensor:  # everything random in a step, rows first, from seed and step alone
            return torch.randn(self.config.batch, 1, generator=self.config.noise(step))

        def loss(self, batch: Tensor, step: int) -> Loss:  # of some of the rows: plain means, nothing random
            error = (self.modules["model"](batch) - 2 * batch).square().mean()
            return Loss(error, {"error": error})

        def save(self, folder: Path, step: int) -> None:  # the model for others; the loop saves its own state
            ...

    train(Line(TrainingConfig(steps=100)), Path("runs/line"))

A task whose batches depend on its own weights (rollouts) may use the weights in `draw`. It may also use torch's global
generator, whose state is saved, and save further state through `state` and `load_state`. See `task` for all hooks.

The live pipeline does not import this room. May import `nn`, `checkpoint`, `held_folder`, `progress` and `echoavatar`.
"""

from .loop import Loop
from .muon import Muon
from .run import Interrupted, train
from .state import has_state
from .task import Gather, Loss, Schedule, TrainingConfig, TrainingTask, adamw, seeded

__all__ = [
    "Gather",
    "Interrupted",
    "Loop",
    "Loss",
    "Muon",
    "Schedule",
    "TrainingTask",
    "TrainingConfig",
    "adamw",
    "has_state",
    "seeded",
    "train",
]
