"""Expressions of eyes and brows: lids slide over the eyeball, eyes turn, brows lift (left side)."""

import numpy as np

from .face_points import FacePoints, Moves, Shares, around, moves, total
from .figure_eyes import EYE, EYE_RADIUS, LID, LID_WIDTH, lower_rim, upper_rim
from .sdf import Points, rise

MEET = 0.17  # where closed lids meet, as a share of the opening from below
TURN = 0.52  # radians an eye turns at a curve of 1


def blink(f: FacePoints) -> Moves:
    """The lids meet."""
    return lids(f, 1 - MEET, MEET)


def squint(f: FacePoints) -> Moves:
    """The lower lid rises, and the upper one meets it half way."""
    return total(lids(f, 0.12, 0.27), cheek_lift(f, 0.0012))


def wide(f: FacePoints) -> Moves:
    """The lids are drawn back."""
    return lids(f, -0.24, -0.10)


def look(f: FacePoints, *, up: float = 0.0, out: float = 0.0) -> Moves:
    """The left eye turns (1 = `TURN`) and the lids go with it."""
    if f.part == "left eye":
        return _turned(f.at, -0.8 * TURN * up, TURN * out)
    return lids(f, (-0.22 if up > 0 else -0.42) * up, 0.10 * up)


def lids(f: FacePoints, upper: float, lower: float) -> Moves:
    """Move the lids of the left eye towards each other by shares of the opening; the skin slides round the eyeball."""
    if f.part not in ("skin", "lashes"):
        return np.zeros_like(f.at)
    local = f.at - EYE
    around_x = np.hypot(local[:, 1], local[:, 2])
    angle = np.arctan2(local[:, 1], local[:, 2])
    x = np.clip(local[:, 0] / LID_WIDTH, -1, 1)
    top, bottom = _rim_angle(x, upper_rim(x)), _rim_angle(x, lower_rim(x))
    opening = np.maximum(top - bottom, 0) * (np.abs(local[:, 0]) < LID_WIDTH)
    is_upper = angle > (top + bottom) / 2
    share = np.where(
        is_upper, 1 - rise(angle - top, 0.0, np.radians(56)), 1 - rise(bottom - angle, 0.0, np.radians(48))
    )
    radius = np.linalg.norm(local, axis=1)
    share = share * (1 - rise(radius, EYE_RADIUS + 0.006, EYE_RADIUS + 0.017)) * (local[:, 2] > 0)
    turn = opening * share * np.where(is_upper, -upper, lower)
    lid = EYE_RADIUS + LID
    thick = np.maximum(radius - lid - 0.001, 0)  # folds are drawn flat over the eyeball
    moving = np.clip(np.abs(turn) / 0.5, 0, 1) * share
    wanted = radius - 0.8 * moving * thick + 0.0007 * np.clip(-turn / 0.5, 0, 1) * is_upper
    new = (
        np.stack([local[:, 0], around_x * np.sin(angle + turn), around_x * np.cos(angle + turn)], axis=1)
        * (wanted / np.maximum(radius, 1e-6))[:, None]
    )
    return np.where((turn != 0)[:, None], new - local, 0.0)


def brow_down(f: FacePoints) -> Moves:
    """The brow is lowered and drawn in."""
    share = _forehead(f, (0.030, 1.611, 0.082), (0.024, 0.014, 0.05))
    inner = _forehead(f, (0.016, 1.608, 0.086), (0.016, 0.014, 0.05))
    return moves(-0.0022 * inner, -0.0048 * share - 0.0022 * inner, 0.0010 * inner)


def brow_inner_up(f: FacePoints) -> Moves:
    """The inner end of the left brow is raised; the shape itself takes both sides."""
    share = _forehead(f, (0.013, 1.614, 0.086), (0.015, 0.019, 0.05))
    return moves(0.0, 0.0072 * share, -0.0008 * share)


def brow_outer_up(f: FacePoints) -> Moves:
    """The outer end of the brow is raised."""
    share = _forehead(f, (0.041, 1.616, 0.076), (0.019, 0.019, 0.05))
    return moves(0.0, 0.0068 * share, -0.0012 * share)


def cheek_lift(f: FacePoints, height: float) -> Moves:
    """The cheek is pushed up against the lower lid."""
    if f.part != "skin":
        return np.zeros_like(f.at)
    share = around(f.at, (0.039, 1.557, 0.072), (0.019, 0.013, 0.03))
    return moves(0.2 * height * share, height * share, 0.45 * height * share)


def cheek_squint(f: FacePoints) -> Moves:
    """The cheek and the lower lid rise."""
    return total(lids(f, 0.02, 0.15), cheek_lift(f, 0.0045))


def _forehead(f: FacePoints, centre: tuple[float, float, float], reach: tuple[float, float, float]) -> np.ndarray:
    if f.part not in ("skin", "brows"):
        return np.zeros(len(f.at))
    lids_rest = rise(f.at[:, 1], 1.594, 1.606)  # the lids' edges stay
    share: Shares = around(f.at, centre, reach) * lids_rest
    return share


def _rim_angle(x: np.ndarray, height: np.ndarray) -> np.ndarray:
    """The angle of a lid's edge about the eye's X axis."""
    rim = EYE_RADIUS + 0.6 * LID
    depth = np.sqrt(np.maximum(rim**2 - (x * LID_WIDTH) ** 2 - height**2, 1e-8))
    angle: np.ndarray = np.arctan2(height, depth)
    return angle


def _turned(at: Points, pitch: float, yaw: float) -> Moves:
    """The eyeball turned about its centre: pitch down positive, yaw to the left positive."""
    c, s, k, m = np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    turn = np.array([[k, 0, m], [0, 1, 0], [-m, 0, k]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    local = at - EYE
    moved: Moves = local @ turn.T - local
    return moved
