"""On SIGTERM or SIGINT a run finishes its step and saves a checkpoint; a second signal ends it at once."""

import signal
import threading
from types import FrameType, TracebackType
from typing import Self

_ASKED = (signal.SIGTERM, signal.SIGINT)


class Interrupted(KeyboardInterrupt):  # noqa: N818  (like KeyboardInterrupt: not an error)
    """A run was asked to end and has been saved. `code` is the shell's exit code for the signal."""

    def __init__(self, message: str, number: int) -> None:
        super().__init__(message)
        self.code = 128 + number


class Signals:
    """Context that records the first signal in `number` and then restores the previous handlers.

    Python delivers signals to the main thread only; entered in another thread this does nothing.
    """

    def __init__(self) -> None:
        self.number = 0
        self._before: dict[signal.Signals, object] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = {which: signal.signal(which, self._note) for which in _ASKED}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._restore()

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.number = number
        self._restore()

    def _restore(self) -> None:
        for which, handler in self._before.items():
            signal.signal(which, handler)  # type: ignore[arg-type]
        self._before = {}
