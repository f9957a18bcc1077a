"""Pictures of a set: lengths of clips, speeds and positions of the hands, joint angles, contact sheets."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar.whole_file import make_output_folder
from echoavatar_lab.data import Corpus
from echoavatar_lab.data.statistics import own_frame, wrist_speeds
from echoavatar_lab.evaluation.pictures import contact_sheet, save_picture
from echoavatar_lab.training.curves import save_figure

MOST_CLIPS = 200  # in the histograms, spread over the set
LONGEST_S = 60.0  # used of each clip
BONES = ("spine", "head", "leftUpperArm", "leftLowerArm", "leftUpperLeg", "leftLowerLeg")
_Array = np.ndarray


def draw_overview(corpus: Corpus, folder: Path, *, sheets: int = 3) -> list[Path]:
    """Write `duration.png`, `speed.png`, `pose.png` and contact sheets of clips spread over the set."""
    make_output_folder(folder)
    names = _spread(corpus.names(has_mirrored=False), MOST_CLIPS)
    motions = [_motion(corpus, name) for name in names]
    pictures = {"duration": _durations(corpus), "speed": _speeds(motions), "pose": _poses(motions)}
    written = []
    for name, figure in pictures.items():
        figure.tight_layout()
        save_figure(figure, folder / f"{name}.png")
        written.append(folder / f"{name}.png")
    for name in _spread(names, sheets):
        path = folder / f"sheet_{name}.png"
        motion = _motion(corpus, name)
        own = motion if motion.skeleton.names == HUMANOID.names else retarget(motion)
        save_picture(path, contact_sheet(own, columns=10, rows=2, size=(150, 220)))
        written.append(path)
    return written


def _spread(names: Sequence[str], count: int) -> list[str]:
    """At most `count` names, evenly spread, including the first and the last."""
    if len(names) <= count:
        return list(names)
    return [names[int(at)] for at in np.linspace(0, len(names) - 1, count).round()]


def _motion(corpus: Corpus, name: str) -> Motion:
    stored = corpus.motion(name)
    motion = Motion(corpus.skeleton_of(name), stored.rotations, stored.root, float(FRAME_RATE_HZ))
    return motion.cut(0, round(LONGEST_S * FRAME_RATE_HZ))


def _durations(corpus: Corpus) -> Any:
    """Lengths of clips by split, and minutes by kind of sound."""
    figure = Figure(figsize=(10, 3.6))
    (left, right) = figure.subplots(1, 2)
    entries = corpus.entries(has_mirrored=False)
    splits = [split for split in ("train", "val", "test") if any(e.split == split for e in entries)]
    lengths = [[e.frames / FRAME_RATE_HZ for e in entries if e.split == split] for split in splits]
    left.hist(
        lengths, bins=24, stacked=True, label=[f"{s}: {len(n)} clips" for s, n in zip(splits, lengths, strict=True)]
    )
    left.set(xlabel="length of a clip, s", ylabel="clips", title=f"{corpus.frames() / FRAME_RATE_HZ / 60:.1f} minutes")
    left.legend()
    heard = {"no sound": sum(e.frames for e in entries if not e.has_sound)}
    for kind in ("silence", "speech", "music"):
        heard[kind] = sum(e.domains[kind] for e in entries if e.has_sound)
    right.barh(list(heard), [frames / FRAME_RATE_HZ / 60 for frames in heard.values()], color="tab:gray")
    right.set(xlabel="minutes", title="what is heard")
    return figure


def _speeds(motions: Sequence[Motion]) -> Any:
    """Speeds of the wrists relative to the hips, and of the hips over the floor."""
    figure = Figure(figsize=(10, 3.6))
    (left, right) = figure.subplots(1, 2)
    wrists = np.concatenate([wrist_speeds(motion) for motion in motions if motion.frames > 1])
    for side, name in enumerate(("left", "right")):
        left.hist(np.clip(wrists[:, side], 0, 4), bins=80, histtype="step", density=True, label=f"{name} wrist")
    left.set(xlabel="speed, m/s (last bin: 4 and more)", ylabel="share", yscale="log", title="hands")
    left.legend()
    travel = [np.linalg.norm(np.diff(motion.root[:, [0, 2]], axis=0), axis=1) * motion.fps for motion in motions]
    right.hist(np.clip(np.concatenate(travel), 0, 3), bins=80, histtype="step", density=True, color="tab:green")
    right.set(xlabel="speed, m/s (last bin: 3 and more)", yscale="log", title="hips over the floor")
    return figure


def _poses(motions: Sequence[Motion]) -> Any:
    """Positions of the wrists from the front, and angles of joints from rest."""
    figure = Figure(figsize=(10, 4.2))
    (left, right) = figure.subplots(1, 2)
    places = np.concatenate([_wrists(motion) for motion in motions])
    left.hist2d(places[:, 0], places[:, 1], bins=90, range=((-1, 1), (-0.6, 1.1)), cmap="magma", norm="log", cmin=1)
    left.set(
        xlabel="to the figure's left, m", ylabel="above the hips, m", title="wrists from the front", aspect="equal"
    )
    degrees: dict[str, list[_Array]] = {}
    for motion in motions:
        bones = bone_map(motion.skeleton)
        for name in BONES:
            if name in bones:
                w = np.abs(motion.rotations[:, bones[name], 0]).clip(0, 1)
                degrees.setdefault(name, []).append(np.degrees(2 * np.arccos(w)))
    for name, angles in degrees.items():
        right.hist(np.concatenate(angles), bins=90, range=(0, 180), histtype="step", density=True, label=name)
    right.set(xlabel="turned from rest, degrees", ylabel="share", yscale="log", title="joints")
    right.legend(fontsize=7)
    return figure


def _wrists(motion: Motion) -> _Array:
    """(2 t, 2): positions of both wrists to the left and above, relative to the hips and their heading."""
    bones = bone_map(motion.skeleton)
    own = own_frame(bones, motion.pose())
    return np.concatenate([own[:, bones["leftHand"], :2], own[:, bones["rightHand"], :2]])
