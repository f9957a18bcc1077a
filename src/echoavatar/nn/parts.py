"""A batch of sessions in parts, shared among threads: rows do not meet, so it matters to none which part it is in.

Torch's own threads share out single operations, which in small networks costs more than it saves (one session's face
takes as long for twice the work), and compiled loops have none. So whole steps are shared out instead, over as many
threads as torch has; each then works in one. The caller works through the parts from the first one on, other threads
from the last one, until they meet: a thread that wakes up late or has a slow core does less, and one that does not wake
up in time is not waited for.
"""

import threading
import weakref
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

import torch

ResultT = TypeVar("ResultT")


class Parts:
    """Threads for the parts of a batch; none is started before a batch is large enough."""

    def __init__(self, name: str, *, least: int) -> None:
        """`least` rows are worth a thread."""
        self._name, self._least = name, least
        self._inboxes: list[SimpleQueue[Sequence[_Call[Any]] | None]] = []
        weakref.finalize(self, _end, self._inboxes)

    def of(self, rows: int) -> tuple[slice, ...]:
        """Equal parts, in order; one where more are not worth it or torch has one thread."""
        count = max(1, min(torch.get_num_threads(), rows // self._least))
        edges = [rows * part // count for part in range(count + 1)]
        return tuple(slice(first, last) for first, last in zip(edges, edges[1:], strict=False))

    def run(self, calls: Sequence[Callable[[], ResultT]]) -> list[ResultT]:
        """What the calls return, one for each part, side by side and in the caller's mode of autograd; in order.

        An error in one is raised once all are done; the first part's first.
        """
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            if len(calls) == 1:
                return [calls[0]()]
            return self._share([_Call(call) for call in calls], min(threads, len(calls)) - 1)
        finally:
            torch.set_num_threads(threads)

    def _share(self, calls: list["_Call[ResultT]"], others: int) -> list[ResultT]:
        while len(self._inboxes) < others:
            self._inboxes.append(SimpleQueue())
            name = f"{self._name}-{len(self._inboxes)}"
            threading.Thread(target=_work, args=(self._inboxes[-1],), name=name, daemon=True).start()
        for inbox in self._inboxes[:others]:
            inbox.put(calls)
        for call in calls:
            call.take()
        for call in calls:
            call.wait()
        return [call.result() for call in calls]


class _Call(Generic[ResultT]):
    """A call in the mode of autograd in which it was asked for, made by whoever takes it first."""

    def __init__(self, call: Callable[[], ResultT]) -> None:
        self._call: Callable[[], ResultT] | None = call
        self._is_inference, self._has_grad = torch.is_inference_mode_enabled(), torch.is_grad_enabled()
        self._is_taken, self._pending = threading.Lock(), threading.Lock()
        self._pending.acquire()
        self._result: ResultT | None = None
        self._error: BaseException | None = None

    def take(self) -> None:
        """Make it, if nobody has taken it."""
        if not self._is_taken.acquire(blocking=False):
            return
        call, self._call = self._call, None  # who wakes up late must not hold what it holds
        assert call is not None
        try:
            if self._is_inference and not torch.is_inference_mode_enabled():
                with torch.inference_mode():
                    self._result = call()
            else:
                with torch.set_grad_enabled(self._has_grad):
                    self._result = call()
        except BaseException as error:  # the caller's, who gets it
            self._error = error
        self._pending.release()

    def wait(self) -> None:
        """Until whoever took it has made it."""
        self._pending.acquire()

    def result(self) -> ResultT:
        """What it returned; an error that it raised is raised again."""
        if self._error is not None:
            raise self._error
        return self._result  # type: ignore[return-value]


def _work(inbox: "SimpleQueue[Sequence[_Call[Any]] | None]") -> None:
    """A thread that does one batch after the other."""
    torch.set_num_threads(1)
    while calls := inbox.get():
        for call in reversed(calls):
            call.take()
        del call, calls  # and what they returned


def _end(inboxes: "list[SimpleQueue[Sequence[_Call[Any]] | None]]") -> None:
    for inbox in inboxes:
        inbox.put(None)
