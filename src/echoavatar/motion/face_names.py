"""Faces of other characters: what the names of their morph targets say, and how our 52 curves drive these.

A name is read as words in any order, case and script: `blendShape1.eyeBlink_L`, `A14_Eye_Blink_Left` and
`CTRL_expressions_eyeBlinkL` are one shape (`words.toml`). The web pages read names by the same tables, which
`scripts/make_face_names.py` writes for them.

A shape that is not one of the 52 curves is a preset: a vowel, another mouth shape of speech, or a mood. A face with
its own jaw and lips gets no vowels, a face with its own smile no happy mood, so that no curve moves a face twice.
"""

import re
import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .arkit import ARKIT_NAMES, VRM_NAMES, Curves, to_vrm
from .kinematics.joint_words import TABLES

VOWELS = VRM_NAMES[:5]
SUMS, MIXED, NEAREST, VRM0 = (TABLES[name] for name in ("sums", "mixed", "nearest", "vrm0"))
PRESETS = (*VOWELS, *SUMS)
SPOKEN = ("jawOpen", "mouthClose", "mouthFunnel", "mouthPucker")  # the curves that the vowels show
ENDINGS = ("shape", "blendshape", "bs", "morph", "target", "key", "mesh", "geo", "both", "div", "max")  # no meaning
PARTS = ("upper", "lower", "up", "down", "in", "out")  # of a shape that others divide, such as `mouthFunnelUL`
_ROWS = {name: row for row, name in enumerate((*ARKIT_NAMES, *PRESETS))}
_SIDES = {"left": "Left", "right": "Right"}
_WORDS = TABLES["sides"] | TABLES["faces"]
_LETTERS = 100  # of a name that are read
_TOKEN = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+|[^\x00-\x7f]+")


class Reading(NamedTuple):
    """What a name says: a curve without its side or a preset, its side ("" for none), and which part of it."""

    shape: str
    side: str
    part: tuple[str, ...]
    is_ours: bool  # in ARKit's own words


def words_of(name: str) -> list[str]:
    """The words of a name in our spelling; unknown words stay as they are."""
    found: list[str] = []
    for token in _TOKEN.findall(name):
        word = token.lower()
        if not word.isdecimal():
            found += (_divided(word) or word).split()
        elif found and found[-1] == "au":
            found[-1] += str(int(word))
    return found


def read_name(name: str) -> Reading | None:
    """What the name of a morph target or an expression says; None if it is no known shape of a face."""
    name = unicodedata.normalize("NFKC", name[:_LETTERS])
    for piece in dict.fromkeys((re.split(r"[.:|/]", name)[-1], name)):
        words = words_of(piece)
        while words and words[-1] in ENDINGS:
            words.pop()
        for start, word in enumerate(words):  # unknown words may stand before, such as the mesh's name
            if found := _phrase(words[start:], is_whole=start == 0):
                return found
            if len(word) > 1 and word in _KNOWN and not word.startswith("au"):
                break
    return None


def driven(names: Sequence[str]) -> Float[np.ndarray, "k n"]:
    """How much of each curve and preset (rows: `ARKIT_NAMES`, `PRESETS`) goes to each target of a mesh."""
    kept = _chosen(names)
    shares = np.zeros((len(_ROWS), len(names)), np.float32)
    for reading, target in kept.items():
        preset = {reading.shape: 1.0} if reading.shape in PRESETS else None
        for row, share in (preset or _expanded(reading.shape, reading.side)).items():
            shares[_ROWS[row], target] += share
    vowels = {reading.shape: target for reading, target in kept.items() if reading.shape in VOWELS}
    for vowel, others in NEAREST.items():
        if vowels and vowel not in vowels:
            stand_in = next((other for other in others.split() if other in vowels), None)
            if stand_in:
                shares[_ROWS[vowel], vowels[stand_in]] = 1
    return shares


def face_weights(shares: Float[np.ndarray, "k n"], curves: Curves) -> Float[np.ndarray, "t n"]:
    """The weights of targets that `driven` describes, 0 to 1; all presets together are at most 1."""
    sums = np.array([[_expanded(name).get(curve, 0) for curve in ARKIT_NAMES] for name in SUMS]).T
    presets = np.concatenate([to_vrm(curves)[:, : len(VOWELS)], np.clip(curves @ sums, 0, 1)], 1)
    presets *= shares[len(ARKIT_NAMES) :].any(1)
    presets /= np.maximum(1, presets.sum(1, keepdims=True))
    return np.asarray(np.clip(np.concatenate([curves, presets], 1) @ shares, 0, 1), np.float32)


def silent_curves(shares: Float[np.ndarray, "k n"]) -> list[str]:
    """The curves that move nothing."""
    rows = tuple(_ROWS)
    moving = {rows[row] for row in np.flatnonzero(shares.any(1))}
    for preset in moving & set(PRESETS):
        moving |= set(SPOKEN) if preset in VOWELS else _expanded(preset).keys()
    return [curve for curve in ARKIT_NAMES if curve not in moving]


def _chosen(names: Sequence[str]) -> dict[Reading, int]:
    """The targets that move, by what their names say: of several for one shape, those that say it best."""
    found: dict[Reading, int] = {}
    for target, name in enumerate(names):
        if reading := read_name(name):
            found.setdefault(reading, target)
    shapes = {reading.shape for reading in found}
    ours = {reading.shape for reading in found if reading.is_ours}
    of_sides = {shape: {r.side for r in found if r.shape == shape} for shape in shapes}
    whole = {(r.shape, r.side, r.is_ours) for r in found if not r.part}
    has_lips = "jawOpen" in shapes and bool(shapes & {"mouthFunnel", "mouthPucker"})
    is_voiced = not has_lips and len(shapes & set(VOWELS)) > ("jawOpen" in shapes)

    def is_moving(reading: Reading) -> bool:
        shape, side, part, is_ours = reading
        if (shape in ours and not is_ours) or (part and (shape, side, is_ours) in whole):
            return False
        if of_sides[shape] > {""} and (side == "") == ({"Left", "Right"} <= of_sides[shape]):
            return False
        if shape in VOWELS or shape in ("PP", "FF", "TH", "CH"):
            return is_voiced and not (shape == "TH" and "tongueOut" in shapes)
        if shape in SUMS or shape == "browUp":
            return not shapes & (SUMS | MIXED)[shape].keys()
        return not (is_voiced and shape in SPOKEN)

    return {reading: target for reading, target in found.items() if is_moving(reading)}


def _expanded(shape: str, side: str = "") -> dict[str, float]:
    """The curves of a shape or a preset, with their shares; a shape without a side takes the mean of both."""
    if parts := (MIXED | SUMS).get(shape):
        rows: dict[str, float] = {}
        for part, share in parts.items():
            rows |= {row: share * value for row, value in _expanded(part, side).items()}
        return rows
    if shape in ARKIT_NAMES:
        return {shape: 1.0}
    return {shape + side: 1.0} if side else {f"{shape}Left": 0.5, f"{shape}Right": 0.5}


def _phrase(words: list[str], *, is_whole: bool) -> Reading | None:
    """What these words say. A letter alone counts only at the end; one or two letters, only as the whole name."""
    if len(words[0]) == 1 < len(words):
        return None
    sides = [_SIDES[word] for word in words if word in _SIDES]
    look = words.index("look") + 1 if "look" in words else len(words)
    direction = _SIDES.get(words[look], "") if look < len(words) else ""
    if direction:
        sides.remove(direction)
    bag = frozenset(words).difference(_SIDES)
    if len(set(sides)) > 1 or (sum(map(len, bag)) <= 2 and not is_whole):
        return None
    side = sides[0] if sides else ""
    if direction and bag <= {"eye", "look"}:
        way = "" if not side else "Out" if side == direction else "In"
        return Reading(f"eyeLook{way}" if way else f"look{direction}", side, (), len(bag) == 2)
    for kept in (bag, bag - {"viseme"}, bag - set(PARTS)):
        is_enough = len(kept) > 1 or not bag & set(PARTS)  # what is left of `mouth up` says nothing
        if (known := _PHRASES.get(kept)) and is_enough:
            shape, is_ours = known
            if shape in ("jaw", "mouth") and not side:
                return None
            return Reading(shape, side, tuple(sorted(bag & set(PARTS) - kept)), is_ours)
    return None


@lru_cache(4096)
def _divided(word: str) -> str | None:
    """Our spelling of a word, or of the words that were written as one; None where part of it is unknown."""
    if word in _SPELT:
        return _SPELT[word]
    for end in range(len(word) - 1, 1, -1):
        if (first := _SPELT.get(word[:end])) and (rest := _divided(word[end:])):
            return f"{first} {rest}"
    return None


def _phrases() -> dict[frozenset[str], tuple[str, bool]]:
    """The words of every shape's names, the shape, and whether they are ARKit's own."""
    bases = {re.sub("(Left|Right)$", "", name) for name in ARKIT_NAMES}
    ours = {base: " ".join(_TOKEN.findall(base)).lower() for base in bases}
    ours = {base: text.replace("inner", "in").replace("outer", "out") for base, text in ours.items()}
    theirs = {
        frozenset(said.split()): (base, False) for base, text in TABLES["shapes"].items() for said in text.split(", ")
    }
    return theirs | {frozenset(text.split()): (base, True) for base, text in ours.items()}


_PHRASES = _phrases()
_KNOWN = {word for bag in _PHRASES for word in bag} | {word for ours in _WORDS for word in ours.split()}
_SPELT = {word: word for word in _KNOWN} | {word: ours for ours, theirs in _WORDS.items() for word in theirs.split()}
_SPELT |= {f"{word}s": ours for word, ours in _SPELT.items() if word.isascii() and len(word) > 2}
