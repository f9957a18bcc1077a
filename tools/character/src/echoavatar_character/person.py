"""The people: shape, colouring, hair and clothes of each. Colours are sRGB."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .base import face_unit, phenotype

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Person:
    """All that distinguishes one person from another."""

    name: str
    body: dict[str, float | tuple[float, float, float]]
    details: dict[str, float]
    rest: dict[str, float]  # curves that are part of the resting face
    skin: Colour
    lips: Colour
    iris: Colour
    hair: Colour
    hair_style: str
    brow_width: float = 1.0
    brow_lift: float = -0.001  # metres
    lash_length: float = 1.0
    stubble: float = 0.0
    outfit: str = "jumper"  # of `clothes.CUTS`
    top: Colour = (120, 130, 140)
    second: Colour = (240, 238, 232)  # of the top: stripes, buttons, or what is worn below
    trousers: Colour = (52, 58, 70)
    denim: bool = False
    thread: Colour = (60, 64, 74)
    belt: Colour = (84, 56, 38)
    shoes: Colour = (232, 230, 225)
    shoe_second: Colour = (120, 126, 132)
    laces: Colour = (246, 246, 243)
    lines: float = 0.0  # wrinkles and uneven skin of age

    def shape(self) -> Float[np.ndarray, "v 3"]:
        """The neutral shape in the base mesh's space."""
        shape = phenotype(**self.body, details=self.details)  # type: ignore[arg-type]
        for name, share in self.rest.items():
            shape = shape + share * face_unit(name)
        return shape


FRIENDLY = {
    "mouthSmileLeft": 0.34,
    "mouthSmileRight": 0.34,
    "cheekSquintLeft": 0.22,
    "cheekSquintRight": 0.22,
    "browInnerUp": 0.14,
    "browOuterUpLeft": 0.10,
    "browOuterUpRight": 0.10,
    "eyeSquintLeft": 0.12,
    "eyeSquintRight": 0.12,
    "eyeBlinkLeft": 0.10,  # the lid lies over the iris
    "eyeBlinkRight": 0.10,
}

MAYA = Person(
    "maya",
    {
        "gender": 0.04,
        "age": 0.5,
        "muscle": 0.46,
        "weight": 0.44,
        "height": 0.5,
        "proportions": 0.95,
        "races": (0.08, 0.30, 0.62),
    },
    {
        "mouth/mouth-angles-up": 0.25,
        "mouth/mouth-upperlip-volume-incr": 0.15,
        "mouth/mouth-scale-horiz-decr": 0.1,
        "head/head-oval": 0.45,
        "head/head-fat-decr": 0.25,
        "eyes/@eye-scale-incr": 0.95,
        "eyes/@eye-corner2-up": 0.35,
        "nose/nose-scale-horiz-decr": 0.45,
        "nose/nose-scale-vert-decr": 0.25,
        "nose/nose-point-width-decr": 0.4,
        "nose/nose-base-up": 0.15,
        "chin/chin-width-decr": 0.4,
        "chin/chin-height-decr": 0.2,
        "cheek/@cheek-bones-incr": 0.3,
        "neck/neck-scale-horiz-decr": 0.3,
    },
    FRIENDLY,
    skin=(222, 172, 146),
    lips=(196, 112, 104),
    iris=(86, 58, 40),
    hair=(84, 62, 49),
    hair_style="bob",
    top=(240, 234, 222),
    second=(44, 58, 92),
    trousers=(50, 64, 90),
    denim=True,
    thread=(196, 146, 92),
)
THEO = Person(
    "theo",
    {
        "gender": 1.0,
        "age": 0.54,
        "muscle": 0.6,
        "weight": 0.5,
        "height": 0.5,
        "proportions": 0.95,
        "races": (0.05, 0.15, 0.80),
    },
    {
        "mouth/mouth-angles-up": 0.3,
        "mouth/mouth-upperlip-volume-incr": 0.2,
        "head/head-oval": 0.15,
        "head/head-fat-decr": 0.25,
        "eyes/@eye-scale-incr": 0.75,
        "nose/nose-scale-horiz-decr": 0.3,
        "nose/nose-point-width-decr": 0.2,
        "chin/chin-jaw-drop-incr": 0.1,
        "chin/chin-prominent-incr": 0.2,
        "cheek/@cheek-bones-incr": 0.25,
        "torso/torso-muscle-pectoral-decr": 1.0,
        "arms/@upperarm-shoulder-muscle-incr": 0.6,
        "head/head-square": 0.3,
        "chin/chin-width-incr": 0.25,
        "eyebrows/eyebrows-trans-down": 0.4,
    },
    FRIENDLY
    | {
        "eyeBlinkLeft": 0.03,
        "eyeBlinkRight": 0.03,
        "browInnerUp": 0.04,
        "browOuterUpLeft": 0.0,
        "browOuterUpRight": 0.0,
    },
    skin=(214, 164, 138),
    lips=(184, 118, 106),
    iris=(72, 88, 88),
    hair=(66, 53, 43),
    hair_style="short",
    brow_width=1.3,
    brow_lift=-0.0045,
    lash_length=0.65,
    stubble=0.5,
    outfit="shirt",
    top=(150, 178, 206),
    second=(244, 242, 236),
    trousers=(178, 160, 130),
    thread=(150, 134, 106),
    belt=(70, 46, 32),
    shoes=(104, 70, 46),
    shoe_second=(78, 52, 36),
    laces=(60, 42, 30),
    lines=0.25,
)
AMARA = Person(
    "amara",
    {
        "gender": 0.03,
        "age": 0.5,
        "muscle": 0.48,
        "weight": 0.43,
        "height": 0.5,
        "proportions": 0.95,
        "races": (0.78, 0.05, 0.17),
    },
    {
        "mouth/mouth-angles-up": 0.25,
        "head/head-oval": 0.45,
        "head/head-fat-decr": 0.25,
        "eyes/@eye-scale-incr": 0.9,
        "eyes/@eye-corner2-up": 0.4,
        "nose/nose-scale-horiz-decr": 0.45,
        "nose/nose-flaring-decr": 0.3,
        "chin/chin-width-decr": 0.3,
        "cheek/@cheek-bones-incr": 0.4,
        "neck/neck-scale-horiz-decr": 0.3,
    },
    FRIENDLY,
    skin=(150, 104, 80),
    lips=(136, 78, 70),
    iris=(70, 46, 32),
    hair=(44, 35, 30),
    hair_style="bun",
    lash_length=1.1,
    outfit="jacket",
    top=(206, 148, 66),
    second=(240, 238, 232),
    trousers=(58, 58, 68),
    thread=(44, 44, 52),
)
PEOPLE = {person.name: person for person in (MAYA, THEO, AMARA)}
