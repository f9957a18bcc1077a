"""Models that a checkpoint folder holds: a config and the weights that go with it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import nn

from echoavatar import checkpoint
from echoavatar.config import Config


class Checkpointed(nn.Module):
    """A model that is made from its config alone."""

    config_type: ClassVar[type[Config]]
    config: Any  # of `config_type`

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a checkpoint folder; the model is ready for use (eval mode).

        Raises:
            CheckpointError: a file is missing, damaged or of another shape.
        """
        return checkpoint.load(folder, cls.config_type, cls).eval()

    def save(self, folder: Path, card: Mapping[str, object], *, dtype: torch.dtype | None = None) -> None:
        """Write a checkpoint folder, with weights in `dtype` where it is given."""
        checkpoint.save(folder, config=self.config, weights=self.state_dict(), card=card, dtype=dtype)
