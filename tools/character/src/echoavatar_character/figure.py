"""The character as a list of pieces, each with its material, its colour and its number of triangles.

One designed look: a friendly young person in a teal bomber jacket over a cream T-shirt, indigo turned-up trousers
and white trainers with coral laces and socks. Colours are sRGB, 0..255.
"""

from typing import NamedTuple

import numpy as np

from . import figure_body as body
from . import figure_hair as hair
from . import figure_hands as hands
from . import figure_head as head
from . import figure_mouth as mouth
from .sculpt import Mesh, sculpt
from .sdf import Field, Points, ellipsoid, mirrored
from .symmetric import CloseUp, sculpt_symmetric

Colour = tuple[int, int, int]

SKIN, LIPS, HAIR = (222, 165, 134), (180, 98, 90), (58, 38, 32)
JACKET, RIBBING, ZIP = (24, 110, 116), (16, 78, 86), (196, 200, 204)
SHIRT, SHIRT_COLLAR, TROUSERS, TURN_UP = (243, 233, 216), (232, 220, 200), (47, 52, 82), (66, 73, 110)
SHOE, SOLE, CORAL = (242, 239, 233), (250, 249, 246), (232, 104, 76)
INSIDE, NOSTRIL = (74, 24, 26), (84, 44, 34)


class Piece(NamedTuple):
    """One closed surface of the figure."""

    name: str
    material: str
    colour: Colour
    field: Field
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    cell: float
    triangles: int
    buried: float = 0.015  # triangles deeper than this inside other pieces are invisible and dropped
    closeups: tuple[CloseUp, ...] = ()


CLOSEUPS = (
    CloseUp((0.0, 1.550, 0.060), 0.060, 1.5),
    CloseUp((0.033, 1.587, 0.076), 0.018, 2.8),
    CloseUp((0.0, 1.5195, 0.088), 0.025, 3.3),
    CloseUp((0.006, 1.549, 0.100), 0.012, 1.5),
)
PIECES = (
    Piece(
        *("head", "skin", SKIN, head.head_skin, (-0.17, 1.325, -0.13), (0.17, 1.72, 0.14), 0.0008, 16500),
        closeups=CLOSEUPS,
    ),
    Piece("hair", "hair", HAIR, hair.hair, (-0.13, 1.45, -0.16), (0.13, 1.76, 0.14), 0.002, 6800, 0.008),
    Piece("brows", "hair", HAIR, head.brow, (-0.07, 1.58, 0.03), (0.07, 1.64, 0.11), 0.0010, 420, 0.002),
    Piece("hands", "skin", SKIN, hands.hands, (-0.88, 1.34, -0.12), (0.88, 1.44, 0.10), 0.0018, 5400, 0.03),
    Piece("jacket", "cloth", JACKET, body.jacket, (-0.70, 0.94, -0.18), (0.70, 1.50, 0.16), 0.003, 6500),
    Piece("ribbing", "cloth", RIBBING, body.ribbing, (-0.71, 0.88, -0.18), (0.71, 1.52, 0.16), 0.003, 2600),
    Piece("zips", "metal", ZIP, body.zips, (-0.10, 0.90, -0.02), (0.10, 1.47, 0.16), 0.0016, 800, 0.012),
    Piece("stripes", "cloth", CORAL, body.stripes, (-0.70, 0.92, -0.18), (0.70, 1.46, 0.18), 0.002, 1800, 0.003),
    Piece("pockets", "cloth", RIBBING, body.pockets, (-0.16, 1.00, 0.04), (0.16, 1.14, 0.16), 0.0016, 300, 0.004),
    Piece("shirt", "cloth", SHIRT, body.shirt, (-0.20, 0.90, -0.16), (0.20, 1.48, 0.16), 0.005, 1600, 0.007),
    Piece("crew neck", "cloth", SHIRT_COLLAR, body.shirt_collar, (-0.12, 1.36, -0.12), (0.12, 1.48, 0.08), 0.003, 700),
    Piece("trousers", "denim", TROUSERS, body.trousers, (-0.24, 0.08, -0.16), (0.24, 1.08, 0.16), 0.005, 3200),
    Piece("turn-ups", "denim", TURN_UP, body.turn_ups, (-0.17, 0.07, -0.10), (0.17, 0.16, 0.08), 0.003, 700),
    Piece("socks", "cloth", CORAL, body.socks, (-0.15, 0.02, -0.08), (0.15, 0.20, 0.04), 0.004, 400, 0.025),
    Piece("shoes", "shoe", SHOE, body.shoes, (-0.17, -0.02, -0.12), (0.17, 0.15, 0.21), 0.0025, 1600),
    Piece("soles", "shoe", SOLE, body.soles, (-0.17, -0.02, -0.12), (0.17, 0.06, 0.21), 0.0025, 1000),
    Piece("laces", "shoe", CORAL, body.laces, (-0.14, 0.04, 0.00), (0.14, 0.12, 0.11), 0.0018, 420, 0.005),
)  # fmt: skip


def piece_mesh(piece: Piece) -> Mesh:
    """The piece's surface in the rest pose."""
    if piece.closeups:
        return sculpt_symmetric(
            piece.field, piece.low, piece.high, cell=piece.cell, triangles=piece.triangles, closeups=piece.closeups
        )
    return sculpt(piece.field, piece.low, piece.high, cell=piece.cell, triangles=piece.triangles)


def piece_colours(piece: Piece, points: Points) -> np.ndarray:
    """The colour (sRGB, float 0..255) of each point: that of the piece, with what is painted on it."""
    paint = np.tile(np.asarray(piece.colour, np.float64), (len(points), 1))
    if piece.name == "head":
        neutral = mouth.closed(points)
        paint = _blend(paint, LIPS, mouth.lip_mask(neutral), 0.0012)
        nostril = ellipsoid(mirrored(points), (0.0072, 1.5445, 0.0940), (0.0042, 0.0036, 0.0060))
        paint = _blend(paint, NOSTRIL, nostril, 0.0016)
        paint = _blend(paint, INSIDE, mouth.inside_mask(points), 0.0020)
        rosy = np.exp(-(np.linalg.norm((np.abs(points) - (0.042, 1.552, 0.070)) / (0.022, 0.016, 0.03), axis=1) ** 2))
        paint = paint + rosy[:, None] * np.array([4.0, -16.0, -14.0])
    if piece.name == "hands":
        paint = _blend(paint, (240, 198, 178), hands.nail_mask(points), 0.0014)
    return paint


def _blend(paint: np.ndarray, colour: Colour, mask: np.ndarray, soft: float) -> np.ndarray:
    """Mix `colour` in where `mask` (a distance) is negative, over a border of `soft` metres."""
    share = np.clip(0.5 - mask / (2 * soft), 0, 1)[:, None]
    mixed: np.ndarray = paint * (1 - share) + np.asarray(colour, np.float64) * share
    return mixed
