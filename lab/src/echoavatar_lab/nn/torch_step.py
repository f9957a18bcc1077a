"""A step of a torch module behind arrays: where a part has no graph, and on a GPU."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Shaped
from torch import Tensor

from echoavatar.nn.state import StreamState


class TorchStep:
    """Takes and gives arrays. The state lies in arrays, too, whose memory tensors share; on a GPU in tensors.

    Worker threads compute a session each, so torch takes no more threads in them.
    """

    def __init__(
        self, step: Callable[..., Tensor], init_state: Callable[[int], StreamState], device: str = "cpu"
    ) -> None:
        """`step` and `init_state` are those of a module that lies on the device."""
        self._step, self._init_state, self._device = step, init_state, torch.device(device)

    def init_state(self, rows: int) -> Any:
        """Nothing seen yet."""
        return self._init_state(rows).mapped(lambda part: part.numpy() if part.device.type == "cpu" else part)

    def step(
        self,
        x: Shaped[np.ndarray, "b ..."],
        state: StreamState,
        active: Bool[np.ndarray, " b"],
        *told: Any,
        **named: Any,
    ) -> Shaped[np.ndarray, "b ..."]:
        """The module's output; `state` moves on in place. Further arguments are arrays for the module, or None."""
        if threading.current_thread() is not threading.main_thread():
            torch.set_num_threads(1)
        with torch.inference_mode():
            given = [self._there(part) for part in (x, active, *told)]
            further = {name: self._there(part) for name, part in named.items()}
            made = self._step(given[0], state.mapped(self._there), *given[1:], **further)
        return made.cpu().numpy()

    def _there(self, part: Any) -> Any:
        return torch.from_numpy(part).to(self._device) if isinstance(part, np.ndarray) else part
