"""The threads that own the model, one a lane: they work while there is work, sleep while there is none."""

import logging
import threading
from types import TracebackType
from typing import Self

import torch

from .engine import Engine

_LOG = logging.getLogger(__name__)
NAP_S = 0.05


class EngineThread:
    """Runs an engine from `start` to `stop`; a context manager does both.

    With several lanes a session whose sound comes while another is stepped need not wait for it. A step that fails is
    logged once with its trace and ends all threads; `error` holds it.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.error: BaseException | None = None
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=self._run, name=f"echoavatar engine {lane}", daemon=True)
            for lane in range(engine.lanes)
        ]

    @property
    def is_alive(self) -> bool:
        """Whether all threads run."""
        return all(thread.is_alive() for thread in self._threads)

    def start(self) -> Self:
        """Begin."""
        for thread in self._threads:
            thread.start()
        return self

    def stop(self) -> None:
        """Finish the steps in hand and end."""
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
        if self.engine.lanes > 1:
            torch.set_num_threads(1)  # of this thread
        try:
            while not self._stopping.is_set():
                if not self.engine.work():
                    self.engine.wait(NAP_S)
        except Exception as error:
            self.error = self.error or error
            self._stopping.set()
            _LOG.exception("the engine stopped")
