"""Adapter for bundles that were trained on a foreign rig: its features become ours, on its bones or the VRM humanoid.

The conventions of the features (axes, unit, up axis) and the rig's own rule for hands are data in the bundle
(`runtime.json`). The skeleton is part of the tokenizer, in metres and our axes. The adapter's output follows our
conventions, so the stages behind the decoder need not know about other rigs.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field

from echoavatar.config import Config
from echoavatar.motion.ik import SwingConfig, swing_clear
from echoavatar.motion.kinematics import Motion, Skeleton, to_features
from echoavatar.motion.kinematics.features import from_features, ground_axes
from echoavatar.motion.kinematics.retarget import LiveRetarget
from echoavatar.nn import StreamState

Array = np.ndarray
Row = tuple[float, float, float]
Matrix = tuple[Row, Row, Row]
Output = Literal["humanoid", "native"]


class RigConfig(Config):
    """How the features of a foreign rig differ from ours."""

    axes: Matrix = Field(description="rotation from the rig's axes to ours (Y up, facing +Z, left +X)")
    metres_per_unit: float = Field(gt=0, description="length of the rig's unit in metres")
    up: int = Field(ge=0, le=2, description="the rig's axis that points up: 0 x, 1 y, 2 z")
    swing: SwingConfig | None = Field(
        default=None, description="how arms are kept off the trunk, in metres and our axes; None: by the stages alone"
    )
    arms: tuple[tuple[int, int], ...] = Field(default=(), description="(upper arm, wrist) joints of `swing`")
    unity: tuple[Matrix, ...] = Field(
        default=(), description="per joint M: Unity's local rotation is M R M^-1 of the rotation R in its own axes"
    )


@dataclass
class RigState(StreamState):
    """The last horizontal offset of the humanoid's root from the source's (metres); whether a frame came yet."""

    offset: Float[Array, "b 2"]
    seen: Float[Array, " b"]


class RigAdapter:
    """Converts decoded features of a foreign rig to our features, streaming."""

    def __init__(self, config: RigConfig, source: Skeleton, output: Output = "humanoid") -> None:
        """`output` chooses the bones: `humanoid` retargets to the VRM set, `native` keeps the rig's own."""
        self.config, self.source = config, source
        self._axes = np.array(config.axes, np.float32)
        self._retarget = LiveRetarget(source) if output == "humanoid" else None
        self.skeleton = source if self._retarget is None else self._retarget.target

    def init_state(self, rows: int) -> RigState:
        """Nothing seen yet."""
        return RigState(np.zeros((rows, 2), np.float32), np.zeros(rows, np.float32))

    def step(
        self, features: Float[Array, "b t c"], state: RigState, active: Bool[Array, " b"]
    ) -> Float[Array, "b t d"]:
        """Features of the next frames, in our conventions."""
        rotations, travel = self.canonical(features)
        if self._retarget is None:
            return self._features(rotations, travel)
        rows, frames = features.shape[:2]
        moved = self._retarget(rotations.reshape(rows * frames, -1, 3, 3))
        offset = moved.offset.reshape(rows, frames, 3)
        is_new = (state.seen == 0)[:, None]
        before = np.where(is_new, offset[:, 0, [0, 2]], state.offset)
        steps = np.diff(offset[:, :, [0, 2]], axis=1, prepend=before[:, None])
        travel = self._retarget.scale * travel
        travel = np.stack(
            [travel[..., 0] + steps[..., 0], travel[..., 1] + offset[..., 1], travel[..., 2] + steps[..., 1]], -1
        )
        state.offset[active], state.seen[active] = offset[active, -1][:, [0, 2]], 1
        return self._features(moved.rotations.reshape(rows, frames, -1, 3, 3), travel)

    def canonical(self, features: Float[Array, "b t c"]) -> tuple[Float[Array, "b t j 3 3"], Float[Array, "b t 3"]]:
        """Rotations in our axes with the arms off the trunk, and travel by frame: metres left, height, metres ahead."""
        config = self.config
        frames = from_features(self.source, features, up=config.up)
        ground = ground_axes(config.up)
        speed = np.diff(frames.root, axis=1, prepend=np.zeros_like(frames.root[:, :1]))
        travel = frames.root.copy()
        travel[..., ground] = speed[..., ground]
        travel = travel @ self._axes.T * config.metres_per_unit
        rotations = self._axes @ frames.rotations @ self._axes.T
        if config.swing is not None:
            rotations = swing_clear(self.source, rotations, config.swing, config.arms)
        return rotations, travel

    def features_of(self, motion: Motion) -> Float[Array, "t c"]:
        """The tokenizer's features of a clip on the source's bones; the inverse of `canonical`.

        As in the published data, height is relative to the first frame, which has the rest pose's height.
        """
        axes, rest = self._axes, self.source.offsets[:1]
        placed = (rest + motion.root - motion.root[:1]) @ axes / self.config.metres_per_unit
        rotations = axes.T @ motion.matrices() @ axes
        return to_features(self.source, rotations, placed, up=self.config.up)

    def _features(self, rotations: Float[Array, "b t j 3 3"], travel: Float[Array, "b t 3"]) -> Float[Array, "b t d"]:
        root = travel.cumsum(1)
        root[..., 1] = travel[..., 1]
        return to_features(self.skeleton, rotations, root, previous_ground=np.zeros((len(root), 2), root.dtype))
