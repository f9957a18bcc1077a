"""Feet of captured dancers made to stand where they stand and to leave the floor where they move.

Dancers drag and turn their feet on the floor, and capture lets standing feet creep. The stages behind the decoder know
standing and lifted feet alone, so a dragged foot becomes a low step here.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_closing, binary_dilation, binary_opening, gaussian_filter1d

from echoavatar.timing import FRAME_RATE_HZ

from ..controls import ANKLE_HEIGHT, BALL_M, Array, Controls, spans_of

STILL_M_S = 0.40  # a low foot whose ball is slower than this stands
LOW_M = 0.045
LIFT_M = 0.07  # at the middle of a step of 15 cm or more


def with_footfalls(controls: Controls) -> Controls:
    """The same dance with feet that do not slide."""
    position, pitch = controls.foot_position.copy(), controls.foot_pitch.copy()
    for side in range(2):
        yaw = controls.foot_yaw[:, side]
        toes = BALL_M * np.stack([np.sin(yaw), np.cos(yaw)], -1)
        ball = gaussian_filter1d(position[:, side][:, [0, 2]] + toes, 0.8, axis=0, mode="nearest")
        height = position[:, side, 1] - ANKLE_HEIGHT
        speed = np.linalg.norm(np.gradient(gaussian_filter1d(ball, 1.0, axis=0), axis=0), axis=-1) * FRAME_RATE_HZ
        stands = binary_closing(binary_opening((speed < STILL_M_S) & (height < LOW_M), np.ones(3)), np.ones(2))
        ball, lift = _stepped(ball, stands)
        position[:, side, 0], position[:, side, 2] = (ball - toes).T
        position[:, side, 1] = ANKLE_HEIGHT + np.where(stands, 0.0, np.maximum(height, lift))
        position[:, side, 1] = np.maximum(ANKLE_HEIGHT, gaussian_filter1d(position[:, side, 1], 0.8, mode="nearest"))
        toes_up = np.minimum(pitch[:, side], 0)
        pitch[:, side] -= toes_up * gaussian_filter1d(binary_dilation(stands, np.ones(3)).astype(float), 1.5)
    return replace(controls, foot_position=position.astype(np.float32), foot_pitch=pitch.astype(np.float32))


def _stepped(ball: Float[Array, "t 2"], stands: Bool[Array, " t"]) -> tuple[Float[Array, "t 2"], Float[Array, " t"]]:
    """The ball's path with each stand at its mean place, and how high the foot is lifted between two stands."""
    out, lift = ball.copy(), np.zeros(len(ball))
    spans = spans_of(stands)
    for a, b in spans:
        out[a:b] = ball[a:b].mean(0)
    ends = [(0, 0), *spans, (len(ball), len(ball))]
    for (_, a), (b, _) in zip(ends, ends[1:], strict=False):
        if b <= a:
            continue
        phase = (np.arange(a, b) - a + 1) / (b - a + 1)
        before = out[a - 1] - ball[a - 1] if a else np.zeros(2)
        after = out[b] - ball[b] if b < len(ball) else np.zeros(2)
        out[a:b] += before + (after - before) * phase[:, None]
        far = float(np.linalg.norm(out[min(b, len(ball) - 1)] - out[max(a - 1, 0)]))
        lift[a:b] = LIFT_M * min(1.0, far / 0.15 + 0.4) * np.sin(np.pi * phase) ** 0.5
    return out, lift
