"""A batch of sessions in parts, a thread each: rows do not meet, so it matters to none which part it is in.

Torch's own threads share out single operations, which in small networks costs about what it saves, and compiled loops
have none. So whole steps are shared out instead, over as many threads as torch has; each then works in one.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

ResultT = TypeVar("ResultT")


class Parts:
    """Threads for the parts of a batch; none is started before a batch is large enough."""

    def __init__(self, name: str, *, least: int) -> None:
        """`least` rows are worth a thread."""
        self._least = least
        self._threads = ThreadPoolExecutor(
            thread_name_prefix=name, initializer=torch.set_num_threads, initargs=(1,)
        )

    def of(self, rows: int) -> list[slice]:
        """Equal parts, in order; one where more are not worth it or torch has one thread."""
        count = max(1, min(torch.get_num_threads(), rows // self._least))
        edges = [rows * part // count for part in range(count + 1)]
        return [slice(first, last) for first, last in zip(edges, edges[1:], strict=False)]

    def map(self, work: Callable[[slice], ResultT], parts: list[slice]) -> list[ResultT]:
        """What `work` makes of each part, side by side and in the caller's mode of autograd; in order."""
        is_inference, has_grad = torch.is_inference_mode_enabled(), torch.is_grad_enabled()

        def run(part: slice) -> ResultT:
            with torch.inference_mode(is_inference), torch.set_grad_enabled(has_grad):
                return work(part)

        return list(self._threads.map(run, parts))
