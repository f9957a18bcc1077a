"""Skin weights of the bends: a surface passes from one bone to the next over the halfway bone between them.

`python -m echoavatar_character.bends [NAME or FILE ...]` says how much of their girth bent shoulders and elbows keep.
"""

import argparse
from pathlib import Path

import numpy as np
from jaxtyping import Float

from echoavatar.files.avatar import CHARACTERS, MATERIALS, Character, load_character
from echoavatar.files.avatar.halfway import BONES, HALFWAY
from echoavatar.motion.kinematics import HUMANOID

from .body import Body
from .fit import NAMES, PARENTS
from .pose import Turns, posed
from .surface import Surface, smoothed

ARMPIT = 0.06  # metres below the joint of a shoulder
SHOULDER, EASED = 0.2, 60  # metres from the joint in which weights are smoothed, most within half of it, and how often
CLOTH = [material.name for material in MATERIALS].index("cloth")
Points = Float[np.ndarray, "... 3"]
BENDS = {  # bone, its rotation vector, and how far from its joint the sleeve is looked at, in metres
    "elbow 90": ("leftLowerArm", (0.0, -float(np.radians(90)), 0.0), 0.09),
    "elbow 130": ("leftLowerArm", (0.0, -float(np.radians(130)), 0.0), 0.09),
    "arm forward 90": ("leftUpperArm", (0.0, -float(np.radians(90)), 0.0), 0.12),
}
MOST, LEAST = 4, 0.004  # joints of a vertex, and the share below which one is left out


def bent(weights: Float[np.ndarray, "v j"], points: Float[np.ndarray, "v 3"], body: Body) -> Float[np.ndarray, "v b"]:
    """Weights over `BONES` from those over the joints of `HUMANOID`; rows sum to 1, with four joints at most.

    Where a share `c` of a vertex is beyond a joint, the halfway bone gets the most at a half, and nothing at 0 and 1.
    """
    made = np.concatenate([weights, np.zeros((len(weights), len(HALFWAY)))], 1)
    for row, name in enumerate(HALFWAY):
        share = _above(points, body, name) if name.endswith("UpperArm") else np.ones(len(points))
        beyond = _beyond(name)
        c = made[:, beyond].sum(1)
        here = (c > 0) & (c < 1)
        halfway = share * (1 - np.abs(2 * c - 1))
        near, far = 1 - c - halfway / 2, c - halfway / 2
        scale = np.ones(made.shape)
        scale[here] = (near / np.maximum(1 - c, 1e-9))[here, None]
        scale[np.ix_(here, beyond)] = (far / np.maximum(c, 1e-9))[here, None]
        made *= scale
        made[:, len(NAMES) + row] += np.where(here, halfway, 0)
    rank = (-made).argsort(1, kind="stable").argsort(1)
    made = np.where((rank >= MOST) | (made < LEAST), 0, made)
    return np.asarray(made / made.sum(1, keepdims=True))


def eased(surface: Surface, body: Body) -> Float[np.ndarray, "v j"]:
    """The surface's weights, smoothed along it near the shoulders, which are square otherwise; rows sum to 1."""
    joints = np.stack([body.joint(f"{side}UpperArm") for side in ("left", "right")])
    far = np.linalg.norm(surface.positions[:, None] - joints, axis=2).min(1)
    share = np.clip(2 * (1 - far / SHOULDER), 0, 1)
    made = smoothed(surface.weights, surface.quads, EASED, 0.5 * share)
    return np.asarray(made / made.sum(1, keepdims=True))


def _above(points: Float[np.ndarray, "v 3"], body: Body, name: str) -> Float[np.ndarray, " v"]:
    """1 above the joint and 0 in the armpit, which lies so far below it that only straight blending keeps it slim."""
    return np.asarray(np.clip((points[:, 1] - body.joint(name)[1]) / ARMPIT + 1, 0, 1))


def _beyond(name: str) -> list[int]:
    """The bone and all that hangs on it, with halfway bones."""
    found = {NAMES.index(name)}
    for joint, parent in enumerate(PARENTS):
        if parent in found:
            found.add(joint)
    below = {NAMES[joint] for joint in found} - {name}
    return sorted(found) + [BONES.index(f"{each}Halfway") for each in HALFWAY if each in below]


def girth_kept(character: Character, bone: str, turn: tuple[float, float, float], reach: float) -> float:
    """How far from a joint the sleeve stays where a turn of the bone pinches it, as a share of a hanging arm's.

    It is the lowest tenth of the sleeve within `reach` metres of the joint, at a shoulder of what lies above the joint;
    `turn` is the bone's rotation vector in the T-pose's axes.
    """
    down, joint = {"leftUpperArm": (0.0, 0.0, -1.2)}, HUMANOID.index(bone)
    hanging, place = _posed(character, down, joint)
    near = np.linalg.norm(hanging - place, axis=1) < reach
    near &= character.materials == CLOTH
    if bone.endswith("UpperArm"):
        near &= hanging[:, 1] > place[1]
    before = np.linalg.norm(hanging[near] - place, axis=1)
    turned, place = _posed(character, {**down, bone: turn}, joint)
    return float(np.percentile(np.linalg.norm(turned[near] - place, axis=1) / before, 10))


def sinks(character: Character, degrees: float) -> float:
    """How far the top of a shoulder between collar and joint sinks on average when the arm is raised, in millimetres.

    `degrees` are counted from an arm that points down.
    """
    joint = HUMANOID.index("leftUpperArm")
    hanging, place = _posed(character, {"leftUpperArm": (0.0, 0.0, -1.2)}, joint)
    raised, _ = _posed(character, {"leftUpperArm": (0.0, 0.0, float(np.radians(degrees - 90)))}, joint)
    near = (hanging[:, 1] > place[1]) & (hanging[:, 0] > 0.5 * place[0]) & (hanging[:, 0] < place[0])
    near &= character.materials == CLOTH
    return float(1000 * (hanging[near, 1] - raised[near, 1]).mean())


def _posed(character: Character, turns: Turns, joint: int) -> tuple[Points, Points]:
    """The vertices in a pose, and where a joint is."""
    points, _, joints = posed(character, turns)
    return points.astype(float), joints[joint]


def main() -> None:
    """Print a row for each character and a column for each bend."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("who", nargs="*", default=list(CHARACTERS), help=f"of {', '.join(CHARACTERS)}, or npz files")
    args = parser.parse_args()
    print("girth kept", *BENDS, "sinks at 150", sep=" | ")
    for who in args.who:
        character = load_character(Path(who) if who.endswith(".npz") else who)
        print(
            who,
            *(f"{100 * girth_kept(character, *bend):.0f} %" for bend in BENDS.values()),
            f"{sinks(character, 150):.0f} mm",
            sep=" | ",
        )


if __name__ == "__main__":
    main()
