"""Poses on the session's clock, which can be read at any moment."""

from collections import deque

import numpy as np
from jaxtyping import Float

from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar.wire import Pose

HISTORY_SAMPLES = 24_000  # samples kept behind the last reading


class PoseTrack:
    """Motion that is still to be shown. The writer bounds its length; poses behind the reader are dropped."""

    def __init__(self) -> None:
        self._blocks: deque[tuple[int, Pose]] = deque()

    @property
    def end(self) -> int:
        """The clock up to which there are poses; 0 if there are none."""
        if not self._blocks:
            return 0
        at, pose = self._blocks[-1]
        return at + len(pose.root) * SAMPLES_PER_FRAME

    def put(self, at: int, pose: Pose) -> None:
        """Add frames from `at` on; they replace existing poses from that moment on."""
        if self._blocks and at < self.end:
            self.cut(at)
        self._blocks.append((at, pose))

    def cut(self, at: int) -> None:
        """Remove all poses from `at` on."""
        kept = deque[tuple[int, Pose]]()
        for start, pose in self._blocks:
            frames = min(len(pose.root), max(0, -(-(at - start) // SAMPLES_PER_FRAME)))
            if frames:
                face = None if pose.face is None else pose.face[:frames]
                kept.append((start, Pose(pose.rotations[:frames], pose.root[:frames], face)))
        self._blocks = kept

    def read(self, at: float) -> Pose | None:
        """The pose at a moment, interpolated between the two frames around it; beyond either end, the nearest frame."""
        while len(self._blocks) > 1 and self._blocks[1][0] < at - HISTORY_SAMPLES:
            self._blocks.popleft()
        if not self._blocks:
            return None
        before, after = self._beside(at)
        share = 0.0 if after[0] <= before[0] else (at - before[0]) / (after[0] - before[0])
        return _interpolate(before[1], after[1], min(max(share, 0.0), 1.0))

    def _beside(self, at: float) -> tuple[tuple[int, Pose], tuple[int, Pose]]:
        """The last frame not after `at`, and the frame that follows it."""
        before: tuple[int, Pose] | None = None
        for start, pose in self._blocks:
            for_block = int((at - start) // SAMPLES_PER_FRAME)
            if for_block < 0:
                first = start, _frame(pose, 0)
                return (before or first), first
            k = min(for_block, len(pose.root) - 1)
            before = start + k * SAMPLES_PER_FRAME, _frame(pose, k)
            if k + 1 < len(pose.root):
                return before, (before[0] + SAMPLES_PER_FRAME, _frame(pose, k + 1))
        assert before is not None  # there is at least one block
        return before, before


def _frame(pose: Pose, k: int) -> Pose:
    return Pose(pose.rotations[k], pose.root[k], None if pose.face is None else pose.face[k])


def _interpolate(a: Pose, b: Pose, share: float) -> Pose:
    """Interpolate linearly, quaternions along the shorter arc and normalised."""
    signs = np.where(np.einsum("jc,jc->j", a.rotations, b.rotations) < 0, -share, share)[:, None]
    rotations: Float[np.ndarray, "j 4"] = a.rotations * (1 - share) + b.rotations * signs
    rotations = rotations / np.maximum(np.sqrt(np.einsum("jc,jc->j", rotations, rotations)), 1e-9)[:, None]
    face = None if a.face is None or b.face is None else a.face * (1 - share) + b.face * share
    return Pose(rotations, a.root * (1 - share) + b.root * share, face)
