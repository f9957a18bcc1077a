"""The threads that run an engine, one for each worker; they sleep while no session is ready."""

import logging
import threading
from types import TracebackType
from typing import Self

import torch

from .engine import Engine

_LOG = logging.getLogger(__name__)
NAP_S = 0.05


class EngineThread:
    """Runs an engine from `start` to `stop`; as a context manager it does both.

    A step that fails is logged once with its traceback and ends all threads; `error` holds it.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.error: BaseException | None = None
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=self._run, name=f"echoavatar engine {worker}", daemon=True)
            for worker in range(engine.workers)
        ]

    @property
    def is_alive(self) -> bool:
        """Whether all threads run."""
        return all(thread.is_alive() for thread in self._threads)

    def start(self) -> Self:
        """Start all threads."""
        for thread in self._threads:
            thread.start()
        return self

    def stop(self) -> None:
        """Let each thread finish the step in hand, and end."""
        self._stopping.set()
        self.engine.wake()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _run(self) -> None:
        if self.engine.workers > 1:
            torch.set_num_threads(1)  # of this thread
        try:
            while not self._stopping.is_set():
                if not self.engine.work():
                    self.engine.wait(NAP_S)
        except Exception as error:
            self.error = self.error or error
            self._stopping.set()
            _LOG.exception("the engine stopped")
