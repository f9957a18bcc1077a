"""A step of a torch module behind arrays: where a part has no graph."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Shaped
from torch import Tensor

from .state import StreamState


class TorchStep:
    """Takes and gives arrays; its state is the module's."""

    def __init__(self, step: Callable[..., Tensor], init_state: Callable[[int], StreamState]) -> None:
        """`step` and `init_state` are those of a module."""
        self._step, self.init_state = step, init_state

    def step(
        self, x: Shaped[np.ndarray, "b ..."], state: StreamState, active: Bool[np.ndarray, " b"], *told: Any
    ) -> Shaped[np.ndarray, "b ..."]:
        """The module's output; `state` moves on in place. Further arguments are arrays for the module."""
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # operations as small as these take longer when torch shares them out
        try:
            with torch.inference_mode():
                given = [torch.from_numpy(part) for part in (active, *told)]
                return self._step(torch.from_numpy(x), state, *given).numpy()
        finally:
            torch.set_num_threads(threads)
