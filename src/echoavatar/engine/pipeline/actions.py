"""Named actions: the first-layer upper-body codes of short reference clips, which steer the generator.

Paper, Exemplar-Driven Control. The paper's directive is one unordered set of codes for the whole clip. Ours is a window
that moves along the clip: at each chunk the set holds the codes within `REACH_S` of the current place, so that a
bow goes down before it comes up. If an action is held longer than its clip lasts, a part of the clip repeats. Codes
have a meaning only to the tokenizer that made them, so a library is part of its bundle (`actions.json`).
"""

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from jaxtyping import Float

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.json_reader import read_object_file
from echoavatar.limits import ACTIONS, OVERLAYS
from echoavatar.motion.action_overlay import Overlay
from echoavatar.timing import CHUNK, ChunkSize
from echoavatar.whole_file import write_whole

FILE = "actions.json"
VERSION = 2  # 1 counted `hold` in chunks of two motion tokens
REACH_S = 0.27  # the set holds the codes up to so far before and after the current place
LONGEST_S = 60.0
NAME = re.compile("[a-z0-9_]{1,64}")  # language models are offered the name; pages and terminals show it
ABOUT = 200  # most letters of a description


class Directive(NamedTuple):
    """What actions ask of the generator in one step, rows first."""

    exemplar: Float[np.ndarray, "b K"]  # intensity of each code of the set, for a generator trained with exemplars
    bias: Float[np.ndarray, "b K"]  # added to the logits of the same codes


@dataclass(frozen=True)
class Action:
    """One exemplar: the code of every motion token of a clip, the chunks that repeat if it is held, and an overlay."""

    name: str
    codes: tuple[int, ...]
    hold: tuple[int, int]  # first chunk that repeats, and the one after the last
    about: str = ""  # description for people and language models
    guides: bool = True  # whether the generator is asked for the codes; a nod leaves arms and hands free
    overlay: Overlay | None = None  # the part that the codes cannot express
    is_set: bool = False  # whether all codes are asked for at once, as in the paper; then `hold` gives the length
    chunk: ChunkSize = CHUNK  # the bundle's chunk

    def __post_init__(self) -> None:
        """Raise EchoAvatarError for words or a length that an action cannot have."""
        if not NAME.fullmatch(self.name):
            raise EchoAvatarError(
                f"{self.name[:80]!r} cannot name an action; use up to 64 letters, digits and underscores"
            )
        if len(self.about) > ABOUT or not self.about.isprintable():
            raise EchoAvatarError(f"the description of {self.name} is not one line of up to {ABOUT} letters")
        if self.seconds > LONGEST_S:
            raise EchoAvatarError(f"{self.name} lasts more than {LONGEST_S:g} s")

    @property
    def chunks(self) -> int:
        """Length of the clip in chunks."""
        if self.is_set:
            return self.hold[1]
        return len(self.codes) // self.chunk.tokens

    @property
    def seconds(self) -> float:
        """Length of the clip in seconds."""
        return self.chunks * self.chunk.seconds

    def length(self, hold_s: float | None) -> int:
        """Length of the action in chunks when it is held for `hold_s` seconds (None: as long as the clip)."""
        extra = 0.0 if hold_s is None else min(hold_s, LONGEST_S)
        return max(self.chunks, round(extra / self.chunk.seconds))

    def place(self, elapsed: int, length: int) -> int:
        """The chunk of the clip that is due after `elapsed` of `length` chunks."""
        first, last = self.hold
        after = self.chunks - last
        if elapsed < last or length <= self.chunks:
            return min(elapsed, self.chunks - 1)
        if length - elapsed <= after:
            return self.chunks - (length - elapsed)
        return first + (elapsed - last) % (last - first)

    def members(self, elapsed: int, length: int, codes: int) -> Float[np.ndarray, " K"]:
        """The set of codes that is due, as a row with 1 for each member."""
        place, row = self.place(elapsed, length), np.zeros(codes, np.float32)
        if not self.guides:
            return row
        if self.is_set:
            row[list(self.codes)] = 1.0
            return row
        tokens, reach = self.chunk.tokens, self.chunk.within(REACH_S)
        near = slice(max(0, place - reach) * tokens, (place + reach + 1) * tokens)
        row[list(self.codes[near])] = 1.0
        return row

    def overlay_at(self, elapsed: int, length: int, intensity: float) -> Overlay | None:
        """The overlay of the chunk that is due, scaled by `intensity`."""
        if self.overlay is None:
            return None
        return self.overlay.chunk(self.place(elapsed, length), self.chunk).scaled(intensity)

    def to_json(self) -> dict[str, object]:
        """The action's entry in `actions.json`, where `hold` counts motion tokens, so that it fits any chunk."""
        hold = [place * self.chunk.tokens for place in self.hold]
        row: dict[str, object] = {"name": self.name, "about": self.about, "hold": hold}
        row |= {"codes": self.codes, "guides": self.guides} | ({"set": True} if self.is_set else {})
        if self.overlay is None:
            return row
        hands = {"hands": self.overlay.hands.to_json()} if self.overlay.hands.joints else {}
        return row | {"overlay": self.overlay.to_json()} | hands

    @classmethod
    def from_json(cls, row: dict[str, Any], chunk: ChunkSize = CHUNK) -> Self:
        """The inverse of `to_json`. Raises KeyError, TypeError or ValueError if something is missing or wrong."""
        first, last = int(row["hold"][0]) // chunk.tokens, math.ceil(int(row["hold"][1]) / chunk.tokens)
        overlay = Overlay.from_json(row["overlay"], row.get("hands")) if "overlay" in row else None
        codes = tuple(int(code) for code in row["codes"])
        guides = bool(row["guides"])
        is_set = bool(row.get("set", False))
        name, hold, about = str(row["name"]), (first, last), str(row["about"])
        return cls(name, codes, hold, about, guides, overlay, is_set, chunk)


class ActionLibrary(dict[str, Action]):
    """Actions by name, in the order they were added. It is not changed: `with_action` makes another."""

    def find(self, name: str) -> Action:
        """The action of that name; case, spaces and hyphens do not matter.

        Raises EchoAvatarError if there is no such action; the message lists the known ones.
        """
        wanted = "_".join(name.lower().replace("-", " ").replace("_", " ").split())
        if wanted not in self:
            known = ", ".join(self) or "none: this bundle has no actions.json"
            raise EchoAvatarError(f"no action {name!r}; there are: {known}")
        return self[wanted]

    def with_action(self, action: Action) -> "ActionLibrary":
        """The library with this action added; it replaces one of the same name."""
        return ActionLibrary({**self, action.name: action})

    def save(self, folder: Path) -> None:
        """Write `actions.json`."""
        rows = [action.to_json() for action in self.values()]
        lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in rows)
        write_whole(folder / FILE, f'{{"version": {VERSION}, "actions": [\n{lines}\n]}}\n')

    @classmethod
    def load(cls, folder: Path, codes: int, chunk: ChunkSize = CHUNK) -> "ActionLibrary":
        """Read `actions.json` if the folder has one. `codes` is the number of codes, `chunk` the bundle's chunk.

        Raises CheckpointError if the file is damaged, or made for another tokenizer.
        """
        path = folder / FILE
        if not path.exists():
            return cls()
        try:
            library = read_object_file(path)
            if library["version"] != VERSION:
                raise ValueError(f"version {library['version']}, read is {VERSION}")
            rows = library["actions"]
            _check_sizes(rows)
            actions = [Action.from_json(row, chunk) for row in rows]
        except (ValueError, LookupError, TypeError, EchoAvatarError) as error:
            raise CheckpointError(f"{path} is not a library of actions ({error!r}); make it again") from error
        for action in actions:
            frames, overlay = action.chunks * chunk.frames, action.overlay
            whole = overlay is None or {len(overlay.rotation_vectors), len(overlay.hands.shares)} == {frames}
            first, last = action.hold
            fits = 0 <= first < last <= action.chunks and all(0 <= code < codes for code in action.codes)
            if not (fits and whole):
                raise CheckpointError(
                    f"{path}: action {action.name!r} was made for another tokenizer; `echoavatar actions add` it again"
                )
        return cls({action.name: action for action in actions})


def _check_sizes(rows: list[dict[str, Any]]) -> None:
    """Refuse more than a library can need before anything is built: few stored numbers can ask for many rotations."""
    hands = [row["hands"] for row in rows if "hands" in row]
    cells = sum(len(stored["shares"]) * len(stored["joints"]) for stored in hands)
    if len(rows) > ACTIONS or cells > OVERLAYS:
        raise ValueError(f"{len(rows):,} actions with {cells:,} rotations of hands, more than are read")
