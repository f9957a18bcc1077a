"""Cut the captured actions of the library out of recordings; run after editing their list.

Run `python scripts/make_captured_actions.py FOLDER` with a folder that holds `gesture_units.csv` and the files that
it names; then `echoavatar actions build --model src/echoavatar/bundles/default`. Units of `corpora.capture.units` are
cut, joined to rest, and kept as keys.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.capture.animated import SUFFIXES, read_animated
from echoavatar_lab.corpora.capture.controls_from_motion import controls_from_motion
from echoavatar_lab.corpora.capture.units import Row, cut_out, rows_of
from echoavatar_lab.corpora.controls import Controls, minimum_jerk, neutral
from echoavatar_lab.corpora.dance.poses import HANDS
from echoavatar_lab.corpora.rehearsal.captured_actions import KEPT, TABLE, UNIT, key_frames

RAISE_S, LOWER_S = 0.45, 0.6  # from rest to the unit's first pose, and back
SMOOTH_FRAMES = 1.5
NEAR = 0.92  # of the greatest distance from rest, from which on a hand counts as being there
TRUNKS = (".vmd",)  # files whose trunk is of a person's proportions
LICENCES = {  # of the sets that actions may be cut from; NOTICE credits them
    "mmdagent_mei_cc_by3": "CC BY 3.0",
    "mmdagent_gene_cc_by4": "CC BY 4.0",
    "reachy2_emotions_apache2": "Apache-2.0",
}


@dataclass(frozen=True)
class Pick:
    """A unit that becomes an action: its file and first second in `gesture_units.csv`, and what it shows.

    Attributes:
        span: seconds of the unit that are used, at people's tempo: without the ways from the file's own rest.
        hand: the shape of the hands, by its name in `dance.poses`, where none was captured.
    """

    file: str
    start_s: float
    span: tuple[float, float]
    about: str
    hand: str = ""
    is_right: bool = False  # the right hand's alone; the left arm hangs


PICKS: Mapping[str, Pick] = {
    "me": Pick("mei_self_introduction.vmd", 0.0, (0.45, 2.3), "lay a hand on the chest: me, I promise", is_right=True),
    "say_goodbye": Pick(
        "mei_bye.vmd", 0.0, (0.3, 1.9), "a small wave beside the shoulder: goodbye, see you", is_right=True
    ),
    "giggle": Pick("mei_laugh.vmd", 0.0, (0.25, 1.6), "laugh with a hand before the mouth", is_right=True),
    "yawn": Pick("mei_idle_yawn.vmd", 0.03, (0.4, 1.8), "yawn behind a hand: tired, bored", is_right=True),
    "confused": Pick("sd_mei_confusion.vmd", 0.0, (0.3, 2.4), "confused: the hands go up and find no answer"),
    "hide_face": Pick("38_Ashamed.vmd", 0.0, (0.5, 1.6), "hide the face in both hands: ashamed, embarrassed"),
    "welcome": Pick("welcoming2.bvh", 2.07, (0.5, 1.7), "open both arms: welcome, here we are", "open"),
    "come_here": Pick("come1.bvh", 2.1, (0.3, 2.4), "beckon with the right hand: come here, join us", "open", True),
    "go_away": Pick("go_away1.bvh", 2.33, (0.6, 1.8), "send somebody away with the right hand", "flat", True),
    "thank": Pick("grateful1.bvh", 2.5, (0.5, 1.8), "both hands to the chest: thank you, deeply moved", "flat"),
    "offer": Pick("helpful2.bvh", 2.23, (0.6, 2.4), "hold out an open hand: may I help, here you are", "open", True),
    "shrug": Pick("indifferent1.bvh", 2.1, (0.35, 1.3), "open both hands at shoulder height: who knows", "open"),
    "oops": Pick("oops1.bvh", 2.07, (0.45, 1.3), "a hand to the mouth: oops, a small mistake", "open"),
    "celebrate": Pick("success1.bvh", 2.17, (0.2, 1.1), "throw both fists up: success, we did it", "fist"),
    "surprised": Pick("surprised1.bvh", 1.9, (0.45, 1.4), "the hands fly up: surprised, really", "open"),
    "afraid": Pick("fear1.bvh", 2.03, (0.35, 1.3), "hands up before the body, drawing back: afraid", "open"),
    "calm_down": Pick("calming1.bvh", 2.27, (0.2, 1.8), "press the air down with both hands: slowly", "flat"),
    "excited": Pick("enthusiastic1.bvh", 2.1, (0.5, 2.2), "shake both raised hands: excited, wonderful", "open"),
    "disgusted": Pick("disgusted1.bvh", 2.3, (0.7, 2.1), "turn away with a hand held out: disgusted", "flat", True),
}


def cut_actions(folder: Path) -> dict[str, dict[str, Any]]:
    """The rows of `captured_actions.json`: all `PICKS`, cut out of the files that the folder's table names.

    Raises:
        MotionError: a file or a unit is missing.
        KeyError: a file belongs to no set of `LICENCES`.
    """
    units = {(Path(row["file"]).name, float(row["start_s"])): row for row in rows_of(folder / "gesture_units.csv")}
    made = {}
    for name, pick in PICKS.items():
        row = units.get((pick.file, pick.start_s))
        if row is None:
            raise MotionError(f"gesture_units.csv has no unit of {pick.file} at {pick.start_s:g} s")
        path = folder / row["file"]
        motion = read_animated(path) if path.suffix in SUFFIXES else resample(retarget(read_bvh(path)), FRAME_RATE_HZ)
        unit = cut_out(controls_from_motion(motion), Row(pick.start_s, float(row["end_s"]), "", float(row["tempo"])))
        controls = _joined(_posed(unit, pick, has_trunk=path.suffix in TRUNKS))
        collection = Path(row["file"]).parts[1]
        about = {"about": pick.about, "source": f"{collection}/{pick.file}", "licence": LICENCES[collection]}
        made[name] = about | {"hold": _hold(controls)} | keys_of(controls)
    return made


def _posed(unit: Controls, pick: Pick, *, has_trunk: bool) -> Controls:
    """The unit on standing legs; hands that were not captured get their shape."""
    unit = unit[slice(*(round(second * FRAME_RATE_HZ) for second in pick.span))]
    body = neutral(len(unit))
    curves = {name: getattr(unit, name).copy() for name in KEPT if name != "spine" or has_trunk}
    if pick.hand:
        curves["fingers"][:] = HANDS[pick.hand]
    if pick.is_right:
        for name in ("shoulder", "wrist", "palm", "elbow_swing", "fingers"):
            curves[name][:, 0] = getattr(body, name)[:, 0]
    return replace(body, **curves)


def _joined(unit: Controls) -> Controls:
    """The unit with ways from rest to it and back."""
    before, after = round(RAISE_S * FRAME_RATE_HZ), round(LOWER_S * FRAME_RATE_HZ)
    at = np.clip(np.arange(-before, len(unit) + after), 0, len(unit) - 1)
    frame = np.arange(len(at))
    share = minimum_jerk(np.clip(frame / before, 0, 1)) * minimum_jerk(np.clip((len(at) - 1 - frame) / after, 0, 1))
    rest = neutral(len(at)).packed()
    whole = rest + share[:, None] * (unit[at].packed() - rest)
    return Controls.unpacked(rest + gaussian_filter1d(whole - rest, SMOOTH_FRAMES, axis=0, mode="nearest"))


def _hold(controls: Controls) -> tuple[float, float]:
    """From the end of the stroke to the beginning of the way back: while a hand is far from rest."""
    away = np.linalg.norm(controls.wrist - controls.wrist[:1], axis=-1).max(1)
    there = np.flatnonzero(away > NEAR * away.max()) / FRAME_RATE_HZ
    return round(float(there[0]), 2), round(float(there[-1]), 2)


def keys_of(controls: Controls) -> dict[str, Any]:
    """The keys of an action's curves, as the file stores them."""
    columns = np.concatenate([getattr(controls, name).reshape(len(controls), -1) for name in KEPT], axis=1)
    keys = np.rint(columns[key_frames(len(controls))] / UNIT).astype(int).tolist()
    return {"frames": len(controls), "keys": keys}


if __name__ == "__main__":
    actions = cut_actions(Path(sys.argv[1]))
    rows = [f"{json.dumps(name)}: {json.dumps(row, separators=(',', ':'))}" for name, row in actions.items()]
    TABLE.write_text("{\n" + ",\n".join(rows) + "\n}\n", "utf-8")
    print(f"{TABLE}: {TABLE.stat().st_size:,} bytes")
