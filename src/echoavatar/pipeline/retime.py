"""Motion in time with what is heard: played slower where a stress or a beat asks the body to brake, then caught up.

Not in the paper, whose generator must be in time by itself; ours is small: it gestures and dances, but not on the
beat. A pulse model (`pulse`) says for each frame how much to brake. Time runs slower there, by which the motion shown
falls behind the motion decoded, by `LARGEST_LAG` frames at most; between the dips time runs faster until they meet
again. Every pose is one that was decoded (or between two such), so that feet and hands stay where they were put; only
when they get there changes. No frame of delay is added: with nothing to brake for, motion passes as it is.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ..kinematics import Skeleton
from ..kinematics.features import feature_size, travel_slice
from ..nn import StreamState, write_rows

TIMING = "timing"  # the stage's name
DEPTH = 0.95  # share of its speed that a body loses where it brakes fully
CATCH_UP = 0.2  # of the lag that a frame makes up for
FASTEST = 1.6  # of the decoded speed, while catching up
LARGEST_LAG = 7  # frames


@dataclass
class RetimeState(StreamState):
    """Zero is a body that has not moved yet."""

    past: Float[Tensor, "b k c"]  # the last decoded frames
    lag: Float[Tensor, " b"]  # frames that the last one shown was behind
    seen: Int[Tensor, " b"]  # frames decoded, as far as they matter


class Retime:
    """The stage between the decoder and `Post`."""

    def __init__(self, skeleton: Skeleton) -> None:
        self._channels = feature_size(skeleton)
        travel = travel_slice(skeleton)
        self._ground = slice(travel.start, travel.start + 2)  # displacements per frame; the third is height

    def init_state(self, rows: int) -> RetimeState:
        """Nothing decoded yet."""
        past = torch.zeros(rows, LARGEST_LAG + 1, self._channels)
        return RetimeState(past, torch.zeros(rows), torch.zeros(rows, dtype=torch.int64))

    def step(
        self,
        features: Float[Tensor, "b t c"],
        brake: Float[Tensor, "b t"],
        state: RetimeState,
        active: Bool[Tensor, " b"],
    ) -> Float[Tensor, "b t c"]:
        """The frames of the next chunk as they shall be shown; `brake` is 0 (go on) to 1 (slowest)."""
        kept, frames = state.past.shape[1], features.shape[1]
        known = torch.cat([state.past, features], 1)
        lags = _lags(brake.numpy(), state.lag.numpy(), state.seen.numpy())
        at = kept - 1 + np.arange(frames + 1) - lags  # the first is the frame shown last
        low = np.floor(at).astype(np.int64)
        share = torch.from_numpy((at - low).astype(np.float32))[..., None]
        before, after = torch.from_numpy(low), torch.from_numpy(np.minimum(low + 1, known.shape[1] - 1))
        shown = _between(known, before[:, 1:], after[:, 1:], share[:, 1:])
        way = _between(known[..., self._ground].cumsum(1), before, after, share)
        shown[..., self._ground] = way.diff(dim=1)
        write_rows(state.past, known[:, -kept:], active)
        write_rows(state.lag, torch.from_numpy(lags[:, -1].astype(np.float32)), active)
        write_rows(state.seen, (state.seen + frames).clamp(max=LARGEST_LAG), active)
        return shown


def _lags(
    brake: Float[np.ndarray, "b t"], lag: Float[np.ndarray, " b"], seen: Int[np.ndarray, " b"]
) -> Float[np.ndarray, "b t+1"]:
    """How many frames behind each frame is shown, from the one before the chunk on."""
    lags = [lag.astype(np.float64)]
    for frame in range(brake.shape[1]):
        pace = np.minimum(1 + CATCH_UP * lags[-1], FASTEST) * (1 - DEPTH * brake[:, frame])
        lags.append(np.clip(lags[-1] + 1 - pace, 0, np.minimum(seen + frame, LARGEST_LAG)))
    return np.stack(lags, 1)


def _between(
    x: Float[Tensor, "b n c"],
    before: Int[Tensor, "b t"],
    after: Int[Tensor, "b t"],
    share: Float[Tensor, "b t 1"],
) -> Float[Tensor, "b t c"]:
    """Frames between those of these indices."""

    def frame(index: Tensor) -> Tensor:
        return x.gather(1, index[..., None].expand(-1, -1, x.shape[2]))

    return frame(before) * (1 - share) + frame(after) * share
