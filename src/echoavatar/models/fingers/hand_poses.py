"""Hand poses: 15 finger bones in 6D, the right hand mirrored, and their principal directions.

A hand has 90 numbers but far fewer degrees of freedom. The model works on coordinates along the principal directions
of good hands, so every output is close to a pose that hands take.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import matrix_from_6d, matrix_to_6d

FINGERS = HUMANOID.config.parts["hands"]  # 15 joints of the left hand, 15 of the right
BONES = len(FINGERS) // 2
HAND_SIZE = 6 * BONES
SIDES = ("left", "right")
MIRROR_6D = (1.0, -1.0, -1.0, -1.0, 1.0, 1.0)  # reflection across x = 0


def hand_poses(fingers: Float[Tensor, "*n 30 3 3"]) -> Float[Tensor, "*n 2 c"]:
    """Left hand, and right hand mirrored, from finger rotations in the order of the rig."""
    six = matrix_to_6d(fingers).reshape(*fingers.shape[:-3], 2, BONES, 6)
    poses: Tensor = (six * _signs(six)).flatten(-2)
    return poses


def finger_rotations(hands: Float[Tensor, "*n 2 c"]) -> Float[Tensor, "*n 30 3 3"]:
    """Inverse of `hand_poses`; any finite numbers give valid rotations."""
    six = hands.reshape(*hands.shape[:-1], BONES, 6)
    return matrix_from_6d((six * _signs(six)).flatten(-3, -2))


def _signs(six: Tensor) -> Tensor:
    signs = torch.ones(2, 1, 6, dtype=six.dtype, device=six.device)
    signs[1] = signs.new_tensor(MIRROR_6D)
    return signs


class HandBasis(NamedTuple):
    """Principal directions of hand poses; the mean variance of the coordinates is 1."""

    mean: Float[Tensor, " c"]
    axes: Float[Tensor, "k c"]
    scale: Float[Tensor, " k"]

    @property
    def spread(self) -> Float[Tensor, " k"]:
        """Standard deviation of each coordinate over the hands it was fitted to."""
        return self.scale / self.scale.square().mean().sqrt()

    def encode(self, hands: Float[Tensor, "*n c"]) -> Float[Tensor, "*n k"]:
        """Coordinates of poses."""
        return (hands - self.mean) @ self.axes.T / self.scale

    def decode(self, coordinates: Float[Tensor, "*n k"]) -> Float[Tensor, "*n c"]:
        """Poses, without the part in the directions left out."""
        return (coordinates * self.scale) @ self.axes + self.mean


def fit_basis(hands: Float[Tensor, "n c"], size: int) -> HandBasis:
    """The `size` directions with most of the variance of hand poses.

    Coordinates are divided by the root of their standard deviation, so that small directions count and large ones still
    count more.
    """
    wide = hands.double()
    mean = wide.mean(0)
    values, vectors = torch.linalg.eigh((wide - mean).T @ (wide - mean) / len(wide))
    spread = values.flip(0)[:size].clamp_min(1e-8).sqrt()
    scale = (spread * spread.mean()).sqrt()
    return HandBasis(mean.float(), vectors.flip(1)[:, :size].T.contiguous().float(), scale.float())
