"""Captured people made by formula: bodies that wait, and one that talks, shifts its weight and steps."""

from dataclasses import replace

import numpy as np

from echoavatar_lab.corpora.capture.library import CapturedClip, CapturedLibrary
from echoavatar_lab.corpora.controls import ANKLE_HEIGHT, Controls, minimum_jerk, neutral


def swaying(frames: int, size: float, seed: int = 0) -> Controls:
    """Weight to and fro, bows and turns of the trunk, arms that swing a little."""
    clock = np.arange(frames)[:, None] / 30
    wave = np.sin(2 * np.pi * (np.array([0.21, 0.13, 0.17, 0.11]) * clock + np.random.default_rng(seed).random(4)))
    base = neutral(frames)
    pelvis, spine, wrist = base.pelvis_position.copy(), base.spine.copy(), base.wrist.copy()
    pelvis[:, 0] += size * wave[:, 0]
    spine[:, 1] += size * wave[:, 1]
    spine[:, 0] += size * wave[:, 2]
    wrist[..., 2] += size * wave[:, 3:]
    return replace(base, pelvis_position=pelvis, spine=spine, wrist=wrist)


def stepping(frames: int) -> Controls:
    """Sways, and moves its left foot out and back every four seconds."""
    base = swaying(frames, 0.08, 7)
    place = base.foot_position.copy()
    phase = np.abs((np.arange(frames) / 60) % 2 - 1)
    out = minimum_jerk((phase - 0.4) / 0.2)
    place[:, 0, 0] += 0.1 * out
    place[:, 0, 1] = ANKLE_HEIGHT + 0.05 * (4 * out * (1 - out))
    return replace(base, foot_position=place)


def library() -> CapturedLibrary:
    clips = [
        CapturedClip(f"wait{i}", "standing", "waits", f"waits/{i}.bvh", "MIT", swaying(400, 0.01, i)) for i in (0, 1)
    ]
    return CapturedLibrary((*clips, CapturedClip("talk", "speech", "talks", "talks/a.bvh", "CC0", stepping(600))))
