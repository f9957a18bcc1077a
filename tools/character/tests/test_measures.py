"""The people's measures beside those of the ANSUR II survey of 4,082 men and 1,986 women.

Gordon et al. 2014, report NATICK/TR-15/007. Bodies are believable: breadths over stature are near the survey's means.
Those of the waist and hips are at its slim end, because soldiers are heavy for their height. Heads are slightly
stylised: larger than the survey's, because a head of natural size looks small on a clothed figure.
"""

import numpy as np
import pytest
from jaxtyping import Bool, Float

from echoavatar.files.avatar import CHARACTERS, MATERIALS, Character, load_character
from echoavatar.files.avatar.halfway import BONES
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_character.pose import DOWN, posed
from echoavatar_character.stored import bone_weights

SIZES = ("stature", "bideltoid", "waist", "hip", "head length", "head breadth")  # metres below
WOMAN = dict(zip(SIZES, (1.628, 0.450, 0.298, 0.355, 0.188, 0.146), strict=True))
MAN = dict(zip(SIZES, (1.756, 0.510, 0.326, 0.346, 0.199, 0.154), strict=True))
SURVEY = {"maya": WOMAN, "theo": MAN, "amara": WOMAN}
LEAST = {"bideltoid": 0.84, "waist": 0.75, "hip": 0.86}  # of the survey's share of the stature
CLOTHES = 0.016  # metres that two layers of cloth add to a breadth
HANGING = {**DOWN, "leftUpperArm": (0.0, 0.0, -1.4), "rightUpperArm": (0.0, 0.0, 1.4)}


def _of(character: Character, *names: str) -> Bool[np.ndarray, " v"]:
    return np.isin(character.materials, [i for i, each in enumerate(MATERIALS) if each.name in names])


def _share(character: Character, *parts: str) -> Float[np.ndarray, " v"]:
    columns = [i for i, bone in enumerate(BONES) if any(part in bone for part in parts)]
    return np.asarray(bone_weights(character)[:, columns].sum(1))


def _breadth(points: Float[np.ndarray, "v 3"], height: float, half: float = 0.015) -> float:
    return float(np.ptp(points[np.abs(points[:, 1] - height) < half][:, 0]))


def measured(character: Character) -> dict[str, float]:
    """Breadths in metres of a person whose arms hang, and the height from chin to crown."""
    points = posed(character, HANGING)[0].astype(float)
    skin, jaw = _of(character, "skin"), np.zeros(52, np.float32)
    jaw[character.face.names.index("jawOpen")] = 1
    sinks = character.positions[:, 1] - character.with_face(jaw)[0][:, 1]
    chin = skin & (sinks > 0.6 * sinks[skin].max()) & (np.abs(points[:, 0]) < 0.012)
    shoulder = float(HUMANOID.rest_positions[HUMANOID.index("leftUpperArm"), 1])
    sleeves = _of(character, "cloth") & (_share(character, "UpperArm") > 0.3) & (points[:, 1] > shoulder - 0.14)
    trunk = points[_of(character, "cloth", "trousers") & (_share(character, "Arm", "Hand") < 0.02)]
    legs = points[_of(character, "trousers")]
    head = points[skin & (_share(character, "head") > 0.9)]
    eyes = points[_of(character, "eye"), 1].mean()
    crown = points[skin, 1].max()
    return {
        "stature": float(crown),
        "bideltoid": float(np.ptp(points[sleeves, 0])),
        "waist": _breadth(trunk, 0.602 * crown),  # at the height of the navel, as the survey's
        "narrowest": min(_breadth(trunk, height) for height in (1.04, 1.07, 1.10)),
        "hip": max(_breadth(legs, height) for height in (0.84, 0.88, 0.92)),
        "head length": float(np.ptp(head[np.abs(head[:, 1] - eyes - 0.035) < 0.02][:, 2])),
        "head breadth": float(np.ptp(head[head[:, 1] > eyes + 0.055][:, 0])),
        "head height": float(crown - points[chin, 1].min()),
    }


@pytest.mark.parametrize("name", CHARACTERS)
def test_bodies_have_the_breadths_of_people(name: str) -> None:
    ours, survey = measured(load_character(name)), SURVEY[name]
    for breadth, least in LEAST.items():
        ratio = (ours[breadth] - CLOTHES) / ours["stature"] * survey["stature"] / survey[breadth]
        assert least < ratio < 1.12, (breadth, ours[breadth], ratio)


@pytest.mark.parametrize("name", CHARACTERS)
def test_heads_are_slightly_larger_than_people_s(name: str) -> None:
    """Between 6.5 and 7.3 heads make the height; people have about 7.5."""
    ours, survey = measured(load_character(name)), SURVEY[name]
    assert 6.5 < ours["stature"] / ours["head height"] < 7.3
    for size in ("head length", "head breadth"):
        ratio = ours[size] / ours["stature"] * survey["stature"] / survey[size]
        assert 0.95 < ratio < 1.18, (size, ours[size], ratio)


@pytest.mark.parametrize("name", CHARACTERS)
def test_trunks_taper_to_the_waist(name: str) -> None:
    """No barrels: a waist is narrower than the shoulders, and women's hips are wider than it."""
    ours = measured(load_character(name))
    assert ours["narrowest"] < 0.72 * ours["bideltoid"]
    if SURVEY[name] is WOMAN:
        assert ours["narrowest"] < 0.85 * ours["hip"]
