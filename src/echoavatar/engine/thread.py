"""The threads that run an engine, one for each worker; they sleep while no session is ready, and restart it."""

import logging
import threading
import time
from types import TracebackType
from typing import Self

import torch

from .engine import Engine

_LOG = logging.getLogger(__name__)
NAP_S = 0.05
MOST_FAULTS, WITHIN_S = 3, 60.0  # the last of so many faults of the engine within a minute ends it


class EngineThread:
    """Runs an engine from `start` to `stop`; as a context manager it does both.

    A fault of a session ends that session, a fault of the engine restarts it. If it fails again and again, all threads
    end, and `error` holds the last fault.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.error: BaseException | None = None
        self._stopping = threading.Event()
        self._healing = threading.Lock()
        self._faults: list[float] = []  # when the engine failed, within the last minute
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
        while not self._stopping.is_set():
            try:
                if self.engine.fault is not None:
                    self._heal()
                elif not self.engine.work():
                    self.engine.wait(NAP_S)
            except Exception as error:
                _LOG.exception("the engine failed")
                self.engine.fault = error

    def _heal(self) -> None:
        """Restart the engine when the other threads have let go of it."""
        with self._healing:
            while self.engine.is_busy and not self._stopping.is_set():
                time.sleep(NAP_S)
            fault, now = self.engine.fault, time.monotonic()
            if fault is None or self._stopping.is_set():
                return
            self._faults = [*(then for then in self._faults if now - then < WITHIN_S), now]
            if len(self._faults) >= MOST_FAULTS:
                self.error = fault
                self._stopping.set()
                _LOG.error("the engine stopped: %d faults within %g s", MOST_FAULTS, WITHIN_S)
                return
            self.engine.restart()
            _LOG.warning("the engine was restarted in %.1f s after a fault: %s", time.monotonic() - now, fault)
