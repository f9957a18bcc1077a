"""The one thread that owns the model: ticks while there is work, sleeps while there is none."""

import logging
import threading
from types import TracebackType
from typing import Self

from .engine import Engine

_LOG = logging.getLogger(__name__)
NAP_S = 0.05


class EngineThread:
    """Runs an engine's ticks from `start` to `stop`; a context manager does both.

    A tick that fails is logged once with its trace and ends the thread; `error` holds it.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.error: BaseException | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="echoavatar engine", daemon=True)

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def start(self) -> Self:
        """Begin."""
        self._thread.start()
        return self

    def stop(self) -> None:
        """Finish the tick in hand and end."""
        self._stopping.set()
        self.engine.wake()
        if self._thread.is_alive():
            self._thread.join()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                if not self.engine.tick():
                    self.engine.wait(NAP_S)
        except Exception as error:
            self.error = error
            _LOG.exception("the engine stopped")
