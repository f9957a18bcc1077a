"""A pipeline of twenty lines: its motion is the running sum of what each row heard."""

from dataclasses import dataclass

import numpy as np

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import ActionLibrary
from echoavatar.engine.pipeline.runtime import SESSION
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.nn import StreamState
from echoavatar.timing import CHUNK, ChunkSize


@dataclass
class Heard(StreamState):
    total: np.ndarray
    seed: np.ndarray


class FakePipeline:
    skeleton = HUMANOID
    chunk: ChunkSize = CHUNK
    actions = ActionLibrary()
    additions = frozenset(SESSION)
    directive_codes = 0
    has_manner = False
    rows_are_apart = True
    device = "cpu"
    face = None

    def init_state(self, rows: int) -> Heard:
        return Heard(np.zeros(rows, np.float32), np.zeros(rows, np.int64))

    def reset(self, state: Heard, rows: np.ndarray, *, seed: int, options: object = None) -> None:
        state.reset(rows)
        state.seed[rows] = seed

    def restart_generator(self, state: Heard, rows: np.ndarray) -> None:
        """Nothing that it remembers is motion."""

    def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> list[MotionChunk]:
        state.total += np.where(active, audio.sum(1), 0)
        frames = audio.shape[1] // 800
        return [
            MotionChunk(np.tile(np.float32([1, 0, 0, 0]), (frames, 52, 1)), np.full((frames, 3), float(total)))
            for total in state.total + state.seed
        ]


def engine(seats: int = 1) -> Engine:
    return Engine(FakePipeline(), seats=seats)  # type: ignore[arg-type]
