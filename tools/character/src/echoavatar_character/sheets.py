"""Contact sheets of a person: `python -m echoavatar_character.sheets [NAME ...]` writes them into docs/img."""

import argparse
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image

from echoavatar.files.avatar import CHARACTERS, Character, load_character, skin
from echoavatar.files.avatar.render import Camera, Paint, Renderer, Surface
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle

Turns = dict[str, tuple[float, float, float]]
Picture = UInt8[np.ndarray, "h w 3"]
DOWN: Turns = {
    "leftUpperArm": (0, 0, -1.2),
    "rightUpperArm": (0, 0, 1.2),
    "leftLowerArm": (0, -0.25, 0),
    "rightLowerArm": (0, 0.25, 0),
}
EXPRESSIONS: tuple[dict[str, float], ...] = (
    {},
    {"mouthSmile": 0.8, "cheekSquint": 0.6},
    {"mouthSmile": 0.7, "jawOpen": 0.3, "eyeWide": 0.3},
    {"mouthFrown": 0.8, "browInnerUp": 0.9},
    {"browDown": 0.9, "mouthPress": 0.6, "noseSneer": 0.4},
    {"eyeWide": 0.9, "browOuterUp": 0.9, "browInnerUp": 0.7, "jawOpen": 0.45},
    {"eyeBlink": 1.0},
    {"eyeLookOutLeft": 0.8, "eyeLookInRight": 0.8},
    {"jawOpen": 0.8},
    {"mouthPucker": 0.9},
    {"mouthFunnel": 0.8, "jawOpen": 0.2},
    {"jawOpen": 0.4, "tongueOut": 0.9},
)  # names without a side stand for both
POSES: tuple[Turns, ...] = (
    {},
    DOWN,
    {"leftUpperArm": (0, 0, 1.3), "rightUpperArm": (0, 0, -1.3)},
    {"leftUpperArm": (0, -1.4, -0.2), "rightUpperArm": (0, 1.4, 0.2)},
    {**DOWN, "leftLowerArm": (0, -2.3, 0), "rightLowerArm": (0, 2.3, 0)},
    {**DOWN, "leftUpperLeg": (-1.6, 0, 0.1), "leftLowerLeg": (1.7, 0, 0)},
    {**DOWN, "rightUpperLeg": (-1.2, 0, -0.5), "rightLowerLeg": (0.4, 0, 0)},
    {**DOWN, "spine": (0.5, 0, 0), "chest": (0.4, 0, 0), "upperChest": (0.3, 0, 0)},
    {**DOWN, "spine": (-0.2, 0, 0), "chest": (-0.25, 0, 0), "neck": (-0.3, 0, 0)},
    {**DOWN, "spine": (0, 0.35, 0), "chest": (0, 0.35, 0), "head": (0, 0.7, 0)},
    {**DOWN, "spine": (0, 0, 0.35), "chest": (0, 0, 0.3)},
    {**DOWN, "head": (0.5, 0, 0)},
    {**DOWN, "head": (-0.5, 0.4, 0.2)},
    {**DOWN, "neck": (0, 0.5, 0), "head": (0, 0.7, 0)},
    {**DOWN, "leftUpperLeg": (0, 0, 0.7), "rightUpperLeg": (0, 0, -0.7)},
    {
        **DOWN, "leftUpperLeg": (-1.5, 0, 0.2),
        "rightUpperLeg": (-1.5, 0, -0.2), "leftLowerLeg": (1.6, 0, 0), "rightLowerLeg": (1.6, 0, 0),
    },
    {
        "leftUpperArm": (0, -1.2, -1.0), "leftLowerArm": (0, -1.9, 0),
        "rightUpperArm": (0, 1.2, 1.0), "rightLowerArm": (0, 1.9, 0),
    },
    {"leftUpperArm": (1.2, 0, 0.9), "leftLowerArm": (0, -1.6, 0), "rightUpperArm": (0, 0, 1.2)},
    {**DOWN, "leftHand": (0, 0, 1.1), "rightHand": (0, 0, 1.1)},
    {
        "leftUpperArm": (0, 0, 0.6), "rightUpperArm": (0, 0.6, 1.2),
        "rightLowerArm": (0, 2.1, 0), "leftUpperLeg": (-0.9, 0, 0.3), "rightUpperLeg": (0.6, 0, 0),
    },
)  # fmt: skip


def shot(
    character: Character, paint: Paint, camera: Camera, size: tuple[int, int], turns: Turns, face: dict[str, float]
) -> Picture:
    """One picture of a pose and an expression."""
    local = torch.eye(3).repeat(HUMANOID.joints, 1, 1)
    for name, turn in turns.items():
        local[HUMANOID.index(name)] = matrix_from_axis_angle(torch.tensor(turn, dtype=torch.float32))
    pose = forward_kinematics(HUMANOID, local, HUMANOID.rest_positions[0])
    weights = np.array([_weight(face, name) for name in character.face.names], np.float32)
    points, normals = skin(character, pose.rotations.numpy(), pose.positions.numpy(), weights)
    return Renderer(*size, camera=camera).draw(Surface(points, normals, paint))


def _weight(face: dict[str, float], name: str) -> float:
    return face.get(name, face.get(name.removesuffix("Left").removesuffix("Right"), 0.0))


def around(degrees: float, distance: float, height: float, view: float) -> Camera:
    """A camera that looks at the axis of the figure at a height, from an angle."""
    turn = np.radians(degrees)
    place = (float(distance * np.sin(turn)), height + 0.03 * distance, float(distance * np.cos(turn)))
    return Camera(place, (0.0, height, 0.0), view)


def grid(pictures: list[Picture], columns: int) -> Picture:
    """Pictures of one size in rows."""
    rows = [np.concatenate(pictures[i : i + columns], 1) for i in range(0, len(pictures), columns)]
    return np.concatenate(rows)


def sheets(character: Character) -> dict[str, Picture]:
    """Portraits from five sides with the whole figure, twelve expressions, and twenty poses."""
    paint = Paint.of(character)
    heads = [shot(character, paint, around(d, 1.2, 1.57, 0.34), (240, 280), DOWN, {}) for d in (0, 40, 90, 140, 180)]
    whole = [shot(character, paint, around(d, 4.2, 0.87, 0.46), (240, 280), DOWN, {}) for d in (12, -40, 180)]
    faces = [shot(character, paint, around(8, 0.85, 1.575, 0.33), (220, 250), DOWN, face) for face in EXPRESSIONS]
    poses = [shot(character, paint, around(15, 5.0, 0.9, 0.46), (200, 230), turns, {}) for turns in POSES]
    return {"rest": grid(heads + whole, 4), "expressions": grid(faces, 6), "poses": grid(poses, 5)}


def main() -> None:
    """Write the sheets of the named people, or of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(CHARACTERS))
    parser.add_argument("--out", type=Path, default=Path("docs/img"))
    args = parser.parse_args()
    for name in args.names:
        for kind, picture in sheets(load_character(name)).items():
            Image.fromarray(picture).save(args.out / f"character_{name}_{kind}.webp", quality=78)


if __name__ == "__main__":
    main()
