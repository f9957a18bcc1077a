"""The threads that run an engine, one for each worker; they sleep while no session is ready, and restart it."""

import logging
import threading
import time
from collections.abc import Callable
from typing import Self

from .engine import Engine

_LOG = logging.getLogger(__name__)
IDLE_S = 1.0  # most that an idle worker sleeps; `Engine.wake` ends it at once
NAP_S = 0.05  # between looks at threads that are to end
MOST_FAULTS, WITHIN_S = 3, 60.0  # so many faults of the engine within a minute end it
STUCK_S = 60.0  # a step that lasts so long never ends: a chunk of sound is less than a second
MOST_BETWEEN_S = 5.0  # most that counts between two looks at a step: over a longer gap the process was suspended


class EngineThread:
    """Runs an engine, as a context manager.

    A fault of a session ends that session, a fault of the engine restarts it. If it fails again and again, all threads
    end, and `error` holds the last fault. `watch` notices a step that never ends.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.error: BaseException | None = None
        self.is_stuck = False  # whether a thread is in a step that never ends
        self.on_change: Callable[[], None] = lambda: None  # called in a thread after a restart, or when faults end all
        self._looked, self._watched_s = time.monotonic(), 0.0  # the last look; how long its oldest step was watched
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

    def __enter__(self) -> Self:
        """Start all threads."""
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Let each thread finish the step in hand, and end; a thread whose step never ends is left behind."""
        self._stopping.set()
        self.engine.wake()
        for thread in self._threads:
            while thread.is_alive() and not self.is_stuck:
                thread.join(NAP_S)
                self.watch()

    def watch(self) -> None:
        """Note as `error` that a step never ends; for another thread to call now and then.

        Nothing can stop a thread from outside, so such an engine cannot be restarted: the process must end.
        """
        now = time.monotonic()
        since, self._looked = now - self._looked, now
        lasted = self.engine.longest_step_s
        self._watched_s = min(lasted, self._watched_s + min(since, MOST_BETWEEN_S) if lasted > since else lasted)
        if self.error is None and self._watched_s > STUCK_S:
            self.error, self.is_stuck = TimeoutError(f"a step has lasted {lasted:.0f} s"), True
            self._stopping.set()
            _LOG.error("the engine stopped: %s", self.error)

    def _run(self) -> None:
        while True:
            wakes = self.engine.wakes
            if self._stopping.is_set():
                return
            try:
                if self.engine.fault is not None:
                    self._heal()
                elif not self.engine.work():
                    self.engine.wait(wakes, IDLE_S)
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
                self.engine.wake()
            else:
                self.engine.restart()
                _LOG.warning("the engine was restarted in %.1f s after a fault: %s", time.monotonic() - now, fault)
            self.on_change()
