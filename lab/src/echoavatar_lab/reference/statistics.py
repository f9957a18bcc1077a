"""The release's motion statistics in the order of our features.

Of the 531 standard deviations 154 are zero or noise (1e-8 to 6e-5), because their joints never move. Dividing by them
would amplify float noise up to ten million times. So these channels are 0 when normalised and their mean when decoded.
"""

import numpy as np
import torch

from echoavatar.motion.kinematics import FeatureStatistics, Skeleton
from echoavatar.motion.kinematics.features import CONSTANT_STD, TRAVEL_SIZE, travel_slice


def feature_order(skeleton: Skeleton) -> list[int]:
    """For each of our channels, its index in the release's order: joints ascending, then the three of travel."""
    six = [6 * joint + k for joint in skeleton.feature_joints for k in range(6)]
    start = travel_slice(skeleton).start
    travel = [6 * skeleton.joints + k for k in range(TRAVEL_SIZE)]
    return [*six[:start], *travel, *six[start:]]


def body_statistics(skeleton: Skeleton, rows: np.ndarray) -> FeatureStatistics:
    """Statistics from the release's mean and standard deviation (2, 531)."""
    mean, std = torch.from_numpy(rows.astype(np.float32))[:, feature_order(skeleton)]
    return FeatureStatistics(mean, std, std >= CONSTANT_STD)
