"""Motion for `score` from a bundle: a clip for the sound of every true clip, and a note of how it was made.

The note (`made.json`) names model, runtime and seed. A folder is never mixed: with other values it is refused. `score`
prints the note of the folder that it scores.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from echoavatar.engine import animate_many
from echoavatar.engine.pipeline import Pipeline
from echoavatar.errors import MotionError
from echoavatar.motion.formats.tables import write_npz

from .motion_folder import ReadOptions, sound_of, takes

NOTE = "made.json"
BATCH = 16


def make_motion(
    pipeline: Pipeline,
    note: Mapping[str, object],
    true: Path,
    folder: Path,
    how: ReadOptions,
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Write `NAME.npz` (our rig or the bundle's, 30 fps) for each true clip's sound; return how many were new.

    Clip k, in order of names, has the seed `seed` + k. A stopped call goes on.

    Raises:
        MotionError: the folder holds motion that was made otherwise.
        AudioError: a clip has no sound.
    """
    folder.mkdir(parents=True, exist_ok=True)
    wanted, known = json.loads(json.dumps(dict(note))), made_how(folder)
    if known is None and any(folder.glob("*.npz")):
        raise MotionError(f"{folder} holds motion without {NOTE}, made elsewhere; name a new folder, or drop --model")
    if known is not None and known != wanted:
        raise MotionError(f"{folder} was made with {known}, now asked for {wanted}; name another folder")
    (folder / NOTE).write_text(json.dumps(wanted) + "\n", encoding="utf-8")
    there = takes(true, how.split)
    left = [(number, name) for number, name in enumerate(there) if not (folder / f"{name}.npz").exists()]
    for first in range(0, len(left), BATCH):
        part = left[first : first + BATCH]
        sounds = [sound_of(name, there[name], how) for _, name in part]
        made = animate_many(pipeline, sounds, seeds=[seed + number for number, _ in part])
        for (_, name), one in zip(part, made, strict=True):
            write_npz(folder / f"{name}.npz", one.motion)
        if progress:
            progress(first + len(part), len(left))
    return len(left)


def made_how(folder: Path) -> dict[str, object] | None:
    """The note of a folder; None where it has none, as of other systems.

    Raises:
        MotionError: the note is damaged.
    """
    path = folder / NOTE
    if not path.is_file():
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise MotionError(f"{path} is damaged ({error}); remove it") from error
    if not isinstance(found, dict):
        raise MotionError(f"{path} is not a note of `score --model`; remove it")
    return found
