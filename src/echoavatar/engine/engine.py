"""Many sessions, one batch: each session owns one row of the pipeline's state, and nothing happens except in `tick`."""

from pathlib import Path

import numpy as np
import torch

from ..errors import EchoAvatarError
from ..generator.linear import Precision
from ..pipeline import Pipeline, load_bundle
from ..timing import CHUNK_SAMPLES
from .session import Session


class Engine:
    """A pure machine: call `tick` from one thread (tests and scripts call it directly)."""

    def __init__(self, pipeline: Pipeline, *, seats: int = 1) -> None:
        if seats < 1:
            raise EchoAvatarError(f"an engine needs at least one seat, got {seats}")
        self._pipeline = pipeline
        self._state = pipeline.init_state(seats)
        self._sessions: dict[int, Session] = {}
        self._seats = seats

    def open(self, *, seed: int = 0) -> Session:
        """Seat a new session; the same seed and audio give the same motion, whoever sits beside it.

        Raises:
            EchoAvatarError: all seats are taken.
        """
        free = [seat for seat in range(self._seats) if seat not in self._sessions]
        if not free:
            raise EchoAvatarError(
                f"all {self._seats} seats are taken; close a session or open the engine with more seats"
            )
        rows = torch.zeros(self._seats, dtype=torch.bool)
        rows[free[0]] = True
        self._pipeline.reset(self._state, rows, seed=seed)
        session = self._sessions[free[0]] = Session(self, free[0], seed=seed)
        return session

    def release(self, session: Session) -> None:
        """Free a session's seat; `Session.close` calls this."""
        self._sessions.pop(session.seat, None)

    @torch.inference_mode()
    def tick(self) -> int:
        """Step every session that has a chunk waiting; return how many moved."""
        ready = [seat for seat, session in self._sessions.items() if session.waiting]
        if not ready:
            return 0
        audio = np.zeros((self._seats, CHUNK_SAMPLES), np.float32)
        active = torch.zeros(self._seats, dtype=torch.bool)
        for seat in ready:
            audio[seat] = self._sessions[seat].next_chunk()
            active[seat] = True
        chunks = self._pipeline.step(torch.from_numpy(audio), self._state, active)
        for seat in ready:
            self._sessions[seat].deliver(chunks[seat])
        return len(ready)


def load(bundle: str | Path = "default", *, seats: int = 1, precision: Precision = "int8") -> Engine:
    """An engine for a bundle: the name of a shipped one, or a folder.

    Raises:
        CheckpointError: no such bundle, or a damaged one.
    """
    return Engine(Pipeline(load_bundle(bundle), precision=precision), seats=seats)
