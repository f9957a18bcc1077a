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
    lash_length: float = 1.0
    stubble: float = 0.0
    top: Colour = (120, 130, 140)
    trousers: Colour = (52, 58, 70)
    shoes: Colour = (225, 222, 215)
    lines: float = 0.0  # wrinkles and uneven skin of age

    def shape(self) -> Float[np.ndarray, "v 3"]:
        """The neutral shape in the base mesh's space."""
        shape = phenotype(**self.body, details=self.details)  # type: ignore[arg-type]
        for name, share in self.rest.items():
            shape = shape + share * face_unit(name)
        return shape


FRIENDLY = {
    "mouthSmileLeft": 0.24,
    "mouthSmileRight": 0.24,
    "cheekSquintLeft": 0.15,
    "cheekSquintRight": 0.15,
    "browInnerUp": 0.12,
    "eyeSquintLeft": 0.10,
    "eyeSquintRight": 0.10,
}

MAYA = Person(
    "maya",
    {
        "gender": 0.06,
        "age": 0.52,
        "muscle": 0.48,
        "weight": 0.47,
        "height": 0.5,
        "proportions": 0.85,
        "races": (0.12, 0.33, 0.55),
    },
    {"mouth/mouth-angles-up": 0.2, "head/head-oval": 0.35},
    FRIENDLY,
    skin=(208, 158, 132),
    lips=(182, 106, 99),
    iris=(86, 62, 44),
    hair=(56, 41, 33),
    hair_style="bob",
    top=(74, 112, 118),
    trousers=(44, 54, 76),
)
THEO = Person(
    "theo",
    {
        "gender": 0.95,
        "age": 0.63,
        "muscle": 0.56,
        "weight": 0.52,
        "height": 0.5,
        "proportions": 0.85,
        "races": (0.05, 0.2, 0.75),
    },
    {"mouth/mouth-angles-up": 0.35, "head/head-oval": 0.2},
    FRIENDLY,
    skin=(202, 150, 124),
    lips=(170, 109, 99),
    iris=(74, 88, 92),
    hair=(66, 56, 49),
    hair_style="short",
    brow_width=1.3,
    lash_length=0.65,
    stubble=0.6,
    top=(88, 92, 104),
    trousers=(104, 94, 80),
    shoes=(84, 62, 48),
    lines=0.5,
)
AMARA = Person(
    "amara",
    {
        "gender": 0.04,
        "age": 0.5,
        "muscle": 0.5,
        "weight": 0.45,
        "height": 0.5,
        "proportions": 0.9,
        "races": (0.8, 0.05, 0.15),
    },
    {"mouth/mouth-angles-up": 0.2, "head/head-oval": 0.3},
    FRIENDLY,
    skin=(132, 92, 73),
    lips=(126, 74, 68),
    iris=(58, 38, 28),
    hair=(34, 28, 25),
    hair_style="bun",
    lash_length=1.1,
    top=(198, 148, 78),
    trousers=(62, 60, 66),
)
PEOPLE = {person.name: person for person in (MAYA, THEO, AMARA)}
