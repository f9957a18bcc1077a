"""The people: shape, colouring, hair and clothes of each. Colours are sRGB."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .base import face_unit, phenotype

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Outfit:
    """Colours and pattern of what is worn; its cut is the person's."""

    name: str
    top: Colour
    second: Colour  # of the top: stripes, checks, buttons, or what is worn below
    trousers: Colour
    pattern: str = "plain"  # of the top: plain, stripes, check, dots or block
    denim: bool = False
    thread: Colour = (60, 64, 74)
    belt: Colour = (84, 56, 38)
    shoes: Colour = (232, 230, 225)
    shoe_second: Colour = (120, 126, 132)
    laces: Colour = (246, 246, 243)
    collar: Colour | None = None  # and cuffs of a shirt; None: as its top


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
    lash_length: float = 1.0  # 0: painted only
    cut: str = "jumper"  # of `clothes.CUTS`
    outfits: tuple[Outfit, ...] = ()  # the first is worn unless another is chosen
    lines: float = 0.0  # wrinkles and uneven skin of age

    def shape(self) -> Float[np.ndarray, "v 3"]:
        """The neutral shape in the base mesh's space."""
        shape = phenotype(**self.body, details=self.details)  # type: ignore[arg-type]
        for name, share in self.rest.items():
            shape = shape + share * face_unit(name)
        return shape


FRIENDLY = {
    "mouthSmileLeft": 0.52,
    "mouthSmileRight": 0.52,
    "cheekSquintLeft": 0.30,
    "cheekSquintRight": 0.30,
    "browInnerUp": 0.16,
    "browOuterUpLeft": 0.14,
    "browOuterUpRight": 0.14,
    "eyeSquintLeft": 0.10,
    "eyeSquintRight": 0.10,
    "eyeBlinkLeft": 0.09,  # the lid lies over the iris
    "eyeBlinkRight": 0.09,
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
        "mouth/mouth-angles-up": 0.45,
        "mouth/mouth-upperlip-volume-incr": 0.15,
        "mouth/mouth-scale-horiz-decr": 0.1,
        "head/head-oval": 0.6,
        "head/head-fat-decr": 0.3,
        "head/head-scale-horiz-decr": 0.2,
        "forehead/forehead-scale-vert-decr": 0.35,
        "eyes/@eye-scale-incr": 1.0,
        "eyes/@eye-corner2-up": 0.35,
        "nose/nose-scale-horiz-decr": 0.45,
        "nose/nose-scale-vert-decr": 0.25,
        "nose/nose-point-width-decr": 0.4,
        "nose/nose-base-up": 0.15,
        "chin/chin-width-decr": 0.6,
        "chin/chin-height-decr": 0.2,
        "cheek/@cheek-bones-incr": 0.35,
        "neck/neck-scale-horiz-decr": 0.3,
        "torso/measure-waist-circ-incr": 0.45,
        "torso/torso-vshape-decr": 0.4,
    },
    FRIENDLY,
    skin=(224, 174, 148),
    lips=(200, 110, 104),
    iris=(104, 76, 54),
    hair=(92, 66, 50),
    hair_style="bob",
    outfits=(
        Outfit("Breton", (240, 234, 222), (44, 58, 92), (50, 64, 90), "stripes", denim=True, thread=(196, 146, 92)),
        Outfit(
            "Rust",
            (172, 84, 52),
            (206, 122, 82),
            (40, 40, 46),
            thread=(74, 74, 82),
            shoes=(78, 52, 38),
            shoe_second=(58, 40, 30),
            laces=(46, 34, 28),
        ),
        Outfit(
            "Sage",
            (130, 152, 126),
            (238, 232, 216),
            (198, 180, 148),
            "block",
            thread=(160, 142, 112),
            belt=(128, 88, 56),
            shoes=(240, 236, 228),
            shoe_second=(130, 152, 126),
        ),
    ),
)
THEO = Person(
    "theo",
    {
        "gender": 1.0,
        "age": 0.54,
        "muscle": 0.56,
        "weight": 0.5,
        "height": 0.5,
        "proportions": 0.95,
        "races": (0.05, 0.15, 0.80),
    },
    {
        "mouth/mouth-angles-up": 0.45,
        "mouth/mouth-upperlip-volume-incr": 0.2,
        "head/head-oval": 0.3,
        "head/head-fat-decr": 0.10,
        "forehead/forehead-scale-vert-decr": 0.5,
        "eyes/@eye-scale-incr": 0.9,
        "eyes/@eye-height2-incr": 0.4,
        "eyes/@eye-bag-decr": 0.9,
        "eyes/@eye-eyefold-up": 0.5,
        "nose/nose-scale-horiz-decr": 0.3,
        "nose/nose-point-width-decr": 0.2,
        "chin/chin-jaw-drop-incr": 0.1,
        "chin/chin-prominent-incr": 0.2,
        "cheek/@cheek-bones-incr": 0.12,
        "torso/torso-muscle-pectoral-decr": 1.2,
        "torso/torso-vshape-decr": 0.8,
        "torso/measure-waist-circ-incr": 0.9,
        "torso/measure-bust-circ-decr": 0.4,
        "arms/@upperarm-shoulder-muscle-incr": 1.0,
        "head/head-square": 0.2,
        "chin/chin-width-incr": 0.15,
        "eyebrows/eyebrows-trans-down": 0.2,
    },
    FRIENDLY
    | {
        "mouthSmileLeft": 0.44,
        "mouthSmileRight": 0.44,
        "cheekSquintLeft": 0.10,
        "cheekSquintRight": 0.10,
        "eyeBlinkLeft": -0.09,  # below 0 a lid is higher than the mesh's
        "eyeBlinkRight": -0.09,
        "eyeSquintLeft": 0.0,
        "eyeSquintRight": 0.0,
        "browInnerUp": 0.06,
        "browOuterUpLeft": 0.02,
        "browOuterUpRight": 0.02,
    },
    skin=(214, 164, 138),
    lips=(188, 120, 108),
    iris=(76, 104, 112),
    hair=(74, 57, 45),
    hair_style="short",
    brow_width=1.3,
    brow_lift=-0.0030,
    lash_length=0.0,
    cut="shirt",
    outfits=(
        Outfit(
            "Oxford",
            (150, 178, 206),
            (244, 242, 236),
            (178, 160, 130),
            thread=(150, 134, 106),
            belt=(70, 46, 32),
            shoes=(104, 70, 46),
            shoe_second=(78, 52, 36),
            laces=(60, 42, 30),
        ),
        Outfit(
            "Flannel",
            (126, 60, 54),
            (34, 38, 52),
            (46, 56, 78),
            "check",
            denim=True,
            thread=(176, 136, 92),
            belt=(60, 42, 30),
            shoes=(92, 72, 52),
            shoe_second=(66, 52, 40),
            laces=(200, 180, 140),
        ),
        Outfit(
            "Charcoal",
            (62, 66, 74),
            (180, 184, 190),
            (110, 114, 120),
            "dots",
            thread=(84, 88, 94),
            belt=(30, 28, 28),
            shoes=(40, 38, 38),
            shoe_second=(30, 28, 28),
            laces=(24, 22, 22),
        ),
    ),
    lines=0.15,
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
        "mouth/mouth-angles-up": 0.4,
        "head/head-oval": 0.6,
        "head/head-fat-decr": 0.3,
        "head/head-scale-horiz-decr": 0.15,
        "forehead/forehead-scale-vert-decr": 0.45,
        "eyes/@eye-scale-incr": 0.95,
        "eyes/@eye-corner2-up": 0.4,
        "nose/nose-scale-horiz-decr": 0.45,
        "nose/nose-flaring-decr": 0.3,
        "chin/chin-width-decr": 0.45,
        "cheek/@cheek-bones-incr": 0.4,
        "neck/neck-scale-horiz-decr": 0.3,
        "torso/measure-waist-circ-incr": 0.6,
        "torso/torso-vshape-decr": 0.4,
    },
    FRIENDLY,
    skin=(154, 107, 82),
    lips=(144, 80, 74),
    iris=(84, 56, 38),
    hair=(50, 39, 33),
    hair_style="bun",
    lash_length=1.1,
    cut="jacket",
    outfits=(
        Outfit("Marigold", (206, 148, 66), (240, 238, 232), (58, 58, 68), thread=(44, 44, 52)),
        Outfit(
            "Emerald",
            (28, 104, 84),
            (34, 36, 40),
            (206, 198, 184),
            thread=(176, 168, 152),
            belt=(120, 84, 54),
            shoes=(60, 44, 36),
            shoe_second=(46, 34, 28),
            laces=(30, 24, 20),
        ),
        Outfit(
            "Checks",
            (224, 214, 200),
            (150, 62, 74),
            (56, 70, 98),
            "check",
            denim=True,
            thread=(190, 146, 96),
            shoes=(238, 234, 228),
            shoe_second=(150, 62, 74),
        ),
    ),
)
PEOPLE = {person.name: person for person in (MAYA, THEO, AMARA)}
