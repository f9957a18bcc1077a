"""Contact sheets of a person: `python -m echoavatar_character.sheets [NAME ...]` writes them into docs/img.

Rest, close-ups, outfits, twelve expressions and twenty extreme poses; and stills of the default bundle's motion for the
shipped speech and music, and of its actions.
"""

import argparse
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

import echoavatar
from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.files.avatar import CHARACTERS, Character, load_character
from echoavatar.files.avatar.avatar_renderer import AvatarRenderer, Shot
from echoavatar.files.avatar.framing import View
from echoavatar.files.avatar.render import Camera, Paint, Renderer, Surface
from echoavatar.models.audio.io import read_audio
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.expression import MOODS
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS

from .pose import DOWN, Turns, posed

Picture = UInt8[np.ndarray, "h w 3"]
Curves = Float[np.ndarray, "t 52"]
QUALITY = 72
SECONDS = 12  # of the shipped sounds
BEGIN, LONG = 32, 120  # frames before an action, and of its session
ACTIONS = ("wave", "thinking", "point_left", "clap", "give_up", "angry", "happy")
VIEWS_OF: dict[str, View] = {"thinking": "bust", "clap": "bust"}
RAISED: Turns = {"leftShoulder": (0, 0, 0.35), "rightShoulder": (0, 0, -0.35)}  # as shoulders do when arms are high


def _mood(name: str) -> dict[str, float]:
    return {curve: float(value) for curve, value in zip(ARKIT_NAMES, MOODS[name], strict=True) if value > 0}


EXPRESSIONS: tuple[dict[str, float], ...] = (
    {},
    _mood("agree"),
    _mood("happy"),
    _mood("sad"),
    _mood("angry"),
    {"eyeWide": 0.9, "browOuterUp": 0.9, "browInnerUp": 0.7, "jawOpen": 0.45},
    _mood("thinking"),
    {"eyeBlink": 1.0},
    {"jawOpen": 0.7, "eyeLookOutLeft": 0.8, "eyeLookInRight": 0.8},
    {"mouthPucker": 0.9},
    {"mouthFunnel": 0.8, "jawOpen": 0.2},
    {"jawOpen": 0.4, "tongueOut": 0.9},
)  # names without a side stand for both
CLOSE_UPS: tuple[tuple[float, dict[str, float]], ...] = (
    (6, {}),
    (35, _mood("happy")),
    (-25, {"jawOpen": 0.4, "mouthUpperUp": 0.2, "mouthLowerDown": 0.2}),
)
POSES: tuple[Turns, ...] = (
    {},
    DOWN,
    {**RAISED, "leftUpperArm": (0, 0, 0.95), "rightUpperArm": (0, 0, -0.95)},
    {"leftUpperArm": (0, -1.4, -0.2), "rightUpperArm": (0, 1.4, 0.2)},
    {**DOWN, "leftLowerArm": (0, -2.3, 0), "rightLowerArm": (0, 2.3, 0)},
    {**DOWN, "leftUpperLeg": (-1.6, 0, 0.1), "leftLowerLeg": (1.7, 0, 0)},
    {**DOWN, "rightUpperLeg": (-1.2, 0, -0.5), "rightLowerLeg": (0.4, 0, 0)},
    {**DOWN, "spine": (0.5, 0, 0), "chest": (0.4, 0, 0), "upperChest": (0.3, 0, 0)},
    {**DOWN, "spine": (-0.2, 0, 0), "chest": (-0.25, 0, 0), "neck": (-0.3, 0, 0)},
    {**DOWN, "spine": (0, 0.35, 0), "chest": (0, 0.35, 0), "head": (0, 0.7, 0)},
    {**DOWN, "spine": (0, 0, 0.35), "chest": (0, 0, 0.3), "rightUpperArm": (0, 0, 0.75)},
    {**DOWN, "head": (0.5, 0, 0)},
    {**DOWN, "head": (-0.5, 0.4, 0.2)},
    {**DOWN, "neck": (0, 0.5, 0), "head": (0, 0.7, 0)},
    {**DOWN, "leftUpperLeg": (0, 0, 0.7), "rightUpperLeg": (0, 0, -0.7)},
    {
        **DOWN, "leftUpperLeg": (-1.5, 0, 0.2),
        "rightUpperLeg": (-1.5, 0, -0.2), "leftLowerLeg": (1.6, 0, 0), "rightLowerLeg": (1.6, 0, 0),
    },
    {
        "leftUpperArm": (0, -1.2, -1.0), "leftLowerArm": (0, -1.5, 0),
        "rightUpperArm": (0, 1.0, 1.0), "rightLowerArm": (0, 1.9, 0),
    },
    {
        "leftShoulder": (0, 0, 0.3), "leftUpperArm": (1.2, 0, 0.6), "leftLowerArm": (0, -1.6, 0),
        "rightUpperArm": (0, 0, 1.2),
    },
    {**DOWN, "leftHand": (0, 0, 1.1), "rightHand": (0, 0, 1.1)},
    {
        "leftShoulder": (0, 0, 0.2), "leftUpperArm": (0, 0, 0.4), "rightUpperArm": (0, 0.6, 1.1),
        "rightLowerArm": (0, 2.1, 0), "leftUpperLeg": (-0.9, 0, 0.3), "rightUpperLeg": (0.6, 0, 0),
    },
)  # fmt: skip


def shot(
    character: Character, paint: Paint, camera: Camera, size: tuple[int, int], turns: Turns, face: dict[str, float]
) -> Picture:
    """One picture of a pose and an expression."""
    weights = np.array([_weight(face, name) for name in character.face.names], np.float32)
    points, normals, _ = posed(character, turns, weights)
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


def stills(character: Character, motion: Motion, face: Curves, frames: list[int], view: View) -> list[Picture]:
    """Frames of a motion with its face, from a film's camera."""
    renderer, pose = AvatarRenderer(character, Shot((220, 220), view)), motion.pose()
    return [renderer.draw(pose.rotations[frame], pose.positions[frame], face[frame]) for frame in frames]


@cache
def performed(name: str) -> tuple[Motion, Curves]:
    """The default bundle's motion and face for the first seconds of the shipped `speech` or `music`."""
    sound = read_audio(Path(echoavatar.__file__).parent / "assets" / f"{name}.ogg")
    made = echoavatar.animate(sound[: round(SECONDS * SAMPLE_RATE_HZ)])
    assert made.face is not None
    return made.motion, made.face


@cache
def acted() -> dict[str, tuple[Motion, Curves]]:
    """A quiet session for each of `ACTIONS`, which begins after a second."""
    pipeline = Pipeline(load_bundle("default"))
    engine = Engine(pipeline, seats=len(ACTIONS), rewind=0, workers=0)
    sessions = {name: engine.open(seed=3) for name in ACTIONS}
    made: dict[str, list[MotionChunk]] = {name: [] for name in ACTIONS}
    for frame in range(0, LONG, pipeline.chunk.frames):
        for name, session in sessions.items():
            if frame == BEGIN:
                session.act(name)
            session.push(np.zeros(pipeline.chunk.samples, np.float32))
        engine.tick()
        for name, session in sessions.items():
            made[name].extend(session)
    whole = {name: join(chunks) for name, chunks in made.items()}
    return {
        name: (Motion(pipeline.skeleton, each.rotations, each.root, float(FRAME_RATE_HZ)), np.asarray(each.face))
        for name, each in whole.items()
    }


def actions_sheet(character: Character) -> Picture:
    """A row for each of `ACTIONS`: six moments of what a session shows."""
    cells = []
    for name, (motion, face) in acted().items():
        first, last = (BEGIN + round(time * FRAME_RATE_HZ) for time in SCRIPTS[name].hold)
        frames = np.linspace(first - 8, last, 6).round().astype(int).tolist()
        cells += stills(character, motion, face, frames, VIEWS_OF.get(name, "front"))
    return grid(cells, 6)


def sheets(character: Character) -> dict[str, Picture]:
    """Portraits from five sides with the whole figure, close-ups, outfits, motion, expressions, and twenty poses."""
    paint = Paint.of(character)
    heads = [shot(character, paint, around(d, 1.2, 1.59, 0.36), (240, 280), DOWN, {}) for d in (0, 40, 90, 140, 180)]
    whole = [shot(character, paint, around(d, 4.2, 0.87, 0.46), (240, 280), DOWN, {}) for d in (12, -40, 180)]
    near = [shot(character, paint, around(d, 0.9, 1.60, 0.31), (400, 440), DOWN, face) for d, face in CLOSE_UPS]
    faces = [shot(character, paint, around(8, 0.95, 1.60, 0.33), (220, 250), DOWN, face) for face in EXPRESSIONS]
    worn = [
        shot(each, Paint.of(each), around(14, 3.3, 0.90, 0.56), (300, 440), DOWN, {})
        for each in map(character.wearing, character.outfits)
    ]
    poses = [shot(character, paint, around(15, 5.0, 0.9, 0.46), (200, 230), turns, {}) for turns in POSES]
    shown = []
    sounds: tuple[tuple[str, View], ...] = (("speech", "bust"), ("music", "front"))
    for name, view in sounds:
        motion, face = performed(name)
        frames = np.linspace(0.25, 0.95, 6) * (motion.frames - 1)
        shown.append(grid(stills(character, motion, face, frames.astype(int).tolist(), view), 6))
    return {
        "rest": grid(heads + whole, 4),
        "close": grid(near, 3),
        "outfits": grid(worn, 3),
        "motion": np.concatenate(shown),
        "expressions": grid(faces, 6),
        "poses": grid(poses, 5),
    }


def main() -> None:
    """Write the sheets of the named people, or of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(CHARACTERS))
    parser.add_argument("--out", type=Path, default=Path("docs/img"))
    args = parser.parse_args()
    for name in args.names:
        for kind, picture in sheets(load_character(name)).items():
            Image.fromarray(picture).save(args.out / f"character_{name}_{kind}.webp", quality=QUALITY, method=6)
    if CHARACTERS[0] in args.names:
        picture = actions_sheet(load_character(CHARACTERS[0]))
        Image.fromarray(picture).save(args.out / "actions.webp", quality=QUALITY, method=6)


if __name__ == "__main__":
    main()
