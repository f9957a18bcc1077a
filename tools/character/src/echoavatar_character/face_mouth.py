"""Expressions of jaw, lips, cheeks and tongue (left side, or both where a shape has no side)."""

import numpy as np

from .face_points import FacePoints, Moves, Shares, around, bell, moves, total
from .figure_mouth import ARCH, WIDE
from .sdf import Distances, rise

HINGE = np.array([0.0, 1.556, 0.004])
JAW_TURN = 0.31  # radians at jawOpen 1
ROUND = 0.009  # metres from the corners of the mouth over which the opening becomes an oval
SEAL = 0.42  # closed lips ride along with the dropping jaw by this share


def jaw_open(f: FacePoints) -> Moves:
    """The jaw turns about its hinge; the corners of the mouth follow half way and come in."""
    narrow = moves(-0.0040 * np.tanh(f.at[:, 0] / 0.010) * _corner(f, 0.016, 0.020) * _skin(f))
    return total(_jaw(f)[:, None] * _drop(f), narrow)


def mouth_close(f: FacePoints) -> Moves:
    """The lips close while the jaw is down: at equal strength this undoes `jaw_open` where the lips meet."""
    if f.part != "skin":
        return np.zeros_like(f.at)
    reach = np.where(f.above > 0, bell(f.height, 0.015), bell(f.height, 0.018))
    share = reach * bell(f.beyond, 0.014) * rise(f.at[:, 2], 0.02, 0.05)
    moved: Moves = (SEAL - _jaw(f))[:, None] * _drop(f) * share[:, None]
    return moved


def jaw_left(f: FacePoints) -> Moves:
    """The jaw moves sideways and takes the lips along."""
    return moves(0.0075 * np.maximum(_jaw(f), 0.35 * _lips(f, 0.014)))


def jaw_forward(f: FacePoints) -> Moves:
    """The jaw moves forwards."""
    return moves(0.0, 0.0, 0.0065 * np.maximum(_jaw(f), 0.25 * _lips(f, 0.010)))


def funnel(f: FacePoints) -> Moves:
    """Lips forwards, round and open, as in "sh"."""
    lips = _lips(f, 0.018)
    part = f.above * 0.0044 * _between(f) * bell(f.height, 0.012) * f.front * _skin(f)
    out = 0.0062 * bell(f.at[:, 0], 0.019) * _lips(f, 0.012)
    return _bent(f, -0.26 * f.at[:, 0] * lips, part, out)


def pucker(f: FacePoints) -> Moves:
    """Lips forwards, small and closed, as in "oo"."""
    lips = _lips(f, 0.018)
    out = 0.0080 * bell(f.at[:, 0], 0.017) * _lips(f, 0.012)
    return _bent(f, -0.40 * f.at[:, 0] * lips, 0.16 * f.height * bell(f.height, 0.010) * lips, out)


def mouth_left(f: FacePoints) -> Moves:
    """The mouth to the left."""
    share = bell(f.height, 0.020) * bell(f.at[:, 0], 0.040) * f.front * _skin(f)
    return _bent(f, 0.0085 * share, 0.0, 0.0)


def smile(f: FacePoints) -> Moves:
    """The left corner up and out, the cheek round."""
    cheek = around(f.at, (0.041, 1.549, 0.070), (0.018, 0.015, 0.03)) * _skin(f)
    round_cheek = moves(0.0012 * cheek, 0.0030 * cheek, 0.0018 * cheek)
    return total(_pulled(f, out=0.0068, up=0.0078, back=0.0012), round_cheek)


def frown(f: FacePoints) -> Moves:
    """The left corner down."""
    return _pulled(f, out=0.0010, up=-0.0072, back=0.0)


def dimple(f: FacePoints) -> Moves:
    """The left corner drawn back into the cheek."""
    return _pulled(f, out=0.0036, up=0.0010, back=0.0034)


def stretch(f: FacePoints) -> Moves:
    """The left corner out and a little down."""
    return _pulled(f, out=0.0078, up=-0.0022, back=0.0006)


def roll_lower(f: FacePoints) -> Moves:
    """The lower lip rolled in over the teeth."""
    lower = (f.above < 0) * _across(f) * f.front * _skin(f)
    rim = bell(np.minimum(f.height, 0) + 0.0085, 0.0055)
    return moves(0.0, 0.0034 * rim * lower, -0.0062 * bell(f.height, 0.0080) * lower)


def roll_upper(f: FacePoints) -> Moves:
    """The upper lip rolled in."""
    upper = (f.above > 0) * _across(f) * f.front * _skin(f)
    rim = bell(np.maximum(f.height, 0) - 0.0072, 0.0050)
    return moves(0.0, -0.0028 * rim * upper, -0.0056 * bell(f.height, 0.0070) * upper)


def shrug_lower(f: FacePoints) -> Moves:
    """The chin pushes up the lower lip, and with it the upper lip."""
    reach = np.where(f.above > 0, bell(f.height, 0.010), bell(f.height, 0.030))
    share = reach * bell(f.at[:, 0], 0.024) * f.front * _skin(f)
    return moves(0.0, 0.0046 * share, 0.0022 * share * bell(f.height, 0.012))


def shrug_upper(f: FacePoints) -> Moves:
    """The upper lip up and forwards, the lower lip after it."""
    reach = np.where(f.above > 0, bell(f.height, 0.014), bell(f.height, 0.009))
    share = reach * bell(f.at[:, 0], 0.024) * f.front * _skin(f)
    return moves(0.0, 0.0038 * share, 0.0032 * share)


def press(f: FacePoints) -> Moves:
    """The left half of the lips pressed thin."""
    share = _left_half(f) * _across(f) * f.front * _skin(f)
    flat = -0.34 * f.height * bell(f.height, 0.0085)
    return total(moves(0.0, flat * share, -0.0022 * bell(f.height, 0.008) * share), _pulled(f, out=0.0014))


def lower_down(f: FacePoints) -> Moves:
    """The left half of the lower lip down."""
    share = (f.above < 0) * _left_half(f) * _between(f) * bell(f.height, 0.017) * f.front * _skin(f)
    return moves(0.0, -0.0072 * share, -0.0010 * share)


def upper_up(f: FacePoints) -> Moves:
    """The left half of the upper lip up, with the fold beside the nose."""
    share = (f.above > 0) * _left_half(f) * _between(f) * bell(f.height, 0.015) * f.front * _skin(f)
    fold = around(f.at, (0.022, 1.545, 0.085), (0.012, 0.010, 0.02)) * _skin(f)
    return moves(0.0, 0.0064 * share + 0.0014 * fold, 0.0008 * share + 0.0008 * fold)


def cheek_puff(f: FacePoints) -> Moves:
    """Both cheeks blown up."""
    folded = f.at * [1, 1, 1]
    folded[:, 0] = np.abs(folded[:, 0])
    share = around(folded, (0.046, 1.530, 0.058), (0.020, 0.020, 0.035)) * _skin(f)
    full = around(folded, (0.0, 1.5195, 0.09), (0.022, 0.016, 0.03)) * _skin(f) * f.front
    return moves(np.tanh(f.at[:, 0] / 0.015) * 0.0085 * share, -0.0004 * share, 0.0065 * share + 0.0016 * full)


def nose_sneer(f: FacePoints) -> Moves:
    """The left wing of the nose up, lip and brow towards it."""
    wing = around(f.at, (0.0130, 1.5515, 0.090), (0.0085, 0.0110, 0.020)) * _skin(f)
    bridge = around(f.at, (0.012, 1.580, 0.085), (0.010, 0.014, 0.020)) * _skin(f)
    up = moves(0.0008 * wing, 0.0036 * wing + 0.0014 * bridge, 0.0006 * bridge)
    return total(up, 0.28 * upper_up(f))


def tongue_out(f: FacePoints) -> Moves:
    """The tongue out between lips that make way for it."""
    if f.part == "tongue":
        along = rise(f.at[:, 2], 0.030, 0.078)
        return moves(0.0, 0.0100 * np.sqrt(along) - 0.0035 * along**3, 0.0400 * along)
    way = _between(f) * bell(f.at[:, 0], 0.020) * bell(f.height, 0.013) * f.front * _skin(f)
    return moves(0.0, np.where(f.above > 0, 0.0036, -0.0052) * way)


def _jaw(f: FacePoints) -> Shares:
    """How much a point follows the jaw: all or nothing at the lips, with a transition round their corners."""
    if f.part != "skin":
        return np.full(len(f.at), float(f.part in ("lower teeth", "tongue")))
    parting = np.maximum(1 - (f.at[:, 0] / WIDE) ** 2, 0)  # sqrt: an oval
    still = (ROUND + 1.5 * f.beyond) ** 2
    free = np.sqrt((parting * ROUND**2 + f.height**2) / (still + f.height**2))
    side = np.where(f.beyond > 0, np.sign(f.height), f.above)
    share = 0.5 * (1 - side * free) * bell(np.maximum(f.height, 0), 0.024)
    throat = 0.5 * np.maximum(1.475 - f.at[:, 1], 0)
    fixed: Shares = share * rise(f.at[:, 2] - throat, 0.0, 0.045)
    return fixed


def _drop(f: FacePoints) -> Moves:
    """The displacement of points fixed to the jaw when it is wide open."""
    c, s = np.cos(JAW_TURN), np.sin(JAW_TURN)
    local = f.at - HINGE
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    dropped: Moves = local @ turn.T - local
    return dropped


def _skin(f: FacePoints) -> Shares:
    return np.full(len(f.at), float(f.part == "skin"))


def _lips(f: FacePoints, reach: float) -> Shares:
    """1 where the lips meet, falling off above, below and beyond the corners."""
    share: Shares = bell(f.height, reach) * bell(f.beyond, 0.014) * f.front * _skin(f)
    return share


def _between(f: FacePoints) -> Shares:
    """1 in the middle of the lips, which may part, and 0 at the corners and beyond."""
    share: Shares = np.maximum(1 - (f.at[:, 0] / WIDE) ** 2, 0)
    return share


def _across(f: FacePoints) -> Shares:
    """Nearly 1 along the lips, 0 a little beyond the corners."""
    share: Shares = np.maximum(1 - (f.at[:, 0] / (1.12 * WIDE)) ** 4, 0)
    return share


def _left_half(f: FacePoints) -> Shares:
    """1 on the left, 0 on the right; the two halves add up to 1."""
    return rise(f.at[:, 0], -0.009, 0.009)


def _corner(f: FacePoints, reach_x: float, reach_y: float) -> Shares:
    """1 at both corners of the mouth."""
    share: Shares = bell(np.abs(f.at[:, 0]) - WIDE, reach_x) * bell(f.height, reach_y) * f.front
    return share


def _pulled(f: FacePoints, *, out: float, up: float = 0.0, back: float = 0.0) -> Moves:
    """Pull the left corner; the lips follow up to the middle."""
    x = f.at[:, 0]
    gate = bell(f.height, 0.017) * f.front * _skin(f)
    spread = rise(x, 0.0, WIDE) * bell(np.maximum(x - WIDE, 0), 0.017) * gate
    lift = rise(x, 0.25 * WIDE, WIDE) * bell(np.maximum(x - WIDE, 0), 0.015) * gate
    return _bent(f, out * spread, up * lift, -back * lift)


def _bent(f: FacePoints, x: Distances, y: Distances | float, z: Distances | float) -> Moves:
    """Displacements whose sideways part follows the arch of the teeth."""
    at = f.at[:, 0]
    return moves(x, y, z - 0.85 * ARCH * ((at + x) ** 2 - at**2))
