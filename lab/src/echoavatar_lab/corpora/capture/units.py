"""Gesture units: single gestures cut from captured people and from animators' work. Not in the paper.

The table `gesture_units.csv` in or above a folder of motion lists them: `file`, `start_s` and `end_s` in the file,
`concept`, `height` of the hand over the shoulder in arm lengths, and `tempo`, the factor that brings its speed to
people's. Units whose concept has no place in speech are left out.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.controls import Array, Controls
from echoavatar_lab.foreign.csv_rows import read_rows

TABLE = "gesture_units.csv"
ACCENT = "accent"
CONCEPTS = {  # concepts that speech has a place for, and the meaning in `gesture.lexicon` that they stand for
    "": ACCENT, "show hand": ACCENT, "funny": ACCENT, "pleased": ACCENT, "greeting wave": "greeting",
    "farewell wave": "greeting", "point": "there", "enumerate": "count", "me/self": "me", "this here (chest)": "here",
    "me/self (hand to chest)": "me", "make space/spread": "size", "beckon/attract": "you",
}  # fmt: skip
HEIGHTS = -0.6, 0.3  # arm lengths, of accents; lower ones hardly leave rest, higher ones are signals
IDLE = 0.35  # a hand that moves by less than this share of the other one's way rests
AWAKE = 0.4  # of its greatest speed: what comes before is left out, so that a unit begins with a stroke


@dataclass(frozen=True)
class Row:
    """Where a unit lies in a file, its meaning (`ACCENT`: none), and the factor on its speed."""

    start_s: float
    end_s: float
    meaning: str
    tempo: float


@dataclass(frozen=True, eq=False)
class GestureUnit:
    """Both hands of one gesture as `Controls.hands` gives them, at 30 fps; the busier hand is the first."""

    hands: Float[Array, "t 2 14"]
    meaning: str
    is_both: bool

    @property
    def seconds(self) -> float:
        """Length in seconds."""
        return len(self.hands) / FRAME_RATE_HZ


def unit_rows(folder: Path) -> dict[str, list[Row]]:
    """Units that speech can use, by the last two parts of a file's path; {} without a table.

    Raises MotionError if the table is too large or lacks a number.
    """
    found: dict[str, list[Row]] = {}
    table = table_above(folder, TABLE)
    for number, row in enumerate(rows_of(table), 2):
        try:
            meaning = CONCEPTS[row["concept"]]
            unit = Row(float(row["start_s"]), float(row["end_s"]), meaning, float(row["tempo"]))
            if meaning != ACCENT or HEIGHTS[0] <= float(row["height"]) <= HEIGHTS[1]:
                found.setdefault("/".join(Path(row["file"]).parts[-2:]), []).append(unit)
        except KeyError as error:
            if error.args[0] != row.get("concept"):
                raise MotionError(f"{table} lacks the column {error.args[0]!r}") from error
        except ValueError as error:
            raise MotionError(f"{table}, line {number}: {error}") from error
    return found


def table_above(folder: Path, name: str) -> Path:
    """The nearest table of a name in a folder or up to two folders above it; in the folder if there is none."""
    tables = [place / name for place in (folder, *folder.resolve().parents[:2])]
    return next((table for table in tables if table.exists()), tables[0])


def rows_of(table: Path) -> list[dict[str, str]]:
    """Rows of a table; [] if there is none. Raises MotionError if the table cannot be read."""
    return read_rows(table, error=MotionError) if table.exists() else []


def cut_out(controls: Controls, row: Row) -> Controls:
    """One unit of a whole file, at people's tempo."""
    part = controls[round(row.start_s * FRAME_RATE_HZ) : round(row.end_s * FRAME_RATE_HZ) + 1]
    if len(part) < 2:
        raise MotionError(f"a unit from {row.start_s} to {row.end_s} s lies outside of its file")
    at = np.linspace(0, len(part) - 1, max(2, round(len(part) / row.tempo)))
    return Controls.unpacked(np.stack([np.interp(at, np.arange(len(part)), curve) for curve in part.packed().T], 1))


def gesture_unit(controls: Controls, meaning: str) -> GestureUnit:
    """A clip of a unit, from where its hands wake up; the hand that moves more comes first."""
    hands = controls.hands()
    speed = np.linalg.norm(np.diff(hands[..., :3], axis=0), axis=-1)
    first, ways = int(np.argmax(speed.max(1) >= AWAKE * speed.max())), speed.sum(0)
    return GestureUnit(hands[first:, np.argsort(-ways)], meaning, bool(ways.min() > IDLE * ways.max()))
