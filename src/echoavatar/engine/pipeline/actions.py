"""Named actions: the first-layer upper-body codes of short reference clips, which steer the generator.

Paper, Exemplar-Driven Control. The paper's directive is a set without order over the whole clip. Ours passes along the
clip: at each chunk the set holds what the clip uses within `REACH` chunks of its place, so that a bow goes down before
it comes up; while an action is held longer than its clip lasts, a stretch of the clip repeats. Codes mean something
only to the tokenizer that made them, so a library lies in its bundle as `actions.json`.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self

import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.limits import CONFIG_BYTES, check_file
from echoavatar.motion.action_overlay import Overlay
from echoavatar.timing import CHUNK, ChunkSize

FILE = "actions.json"
REACH = 1  # chunks before and after the present place that the set also holds
LONGEST_S = 60.0


class Directive(NamedTuple):
    """What actions ask of one step, rows first."""

    exemplar: Float[Tensor, "b K"]  # intensity of each code of the set, for a generator trained with exemplars
    bias: Float[Tensor, "b K"]  # added to the logits of the same codes


@dataclass(frozen=True)
class Action:
    """One exemplar: a code for every motion token of the clip, which chunks repeat when it is held, and an overlay."""

    name: str
    codes: tuple[int, ...]
    hold: tuple[int, int]  # first chunk that repeats, and the one after the last
    about: str = ""  # for people and language models
    guides: bool = True  # whether the codes are asked for; a nod leaves arms and hands free
    overlay: Overlay | None = None  # what the codes cannot say
    is_set: bool = False  # whether all codes are asked for all the time, as the paper has it; `hold` says how long
    chunk: ChunkSize = CHUNK  # of the bundle: what a chunk of it is

    @property
    def chunks(self) -> int:
        """Length of the clip."""
        if self.is_set:
            return self.hold[1]
        return len(self.codes) // self.chunk.tokens

    @property
    def seconds(self) -> float:
        """Length of the clip."""
        return self.chunks * self.chunk.seconds

    def length(self, hold_s: float | None) -> int:
        """Chunks that the action takes when it is to be held for so long (None: as long as the clip)."""
        extra = 0.0 if hold_s is None else min(hold_s, LONGEST_S)
        return max(self.chunks, round(extra / self.chunk.seconds))

    def place(self, elapsed: int, length: int) -> int:
        """Chunk of the clip that is due `elapsed` chunks after the beginning, of `length` in all."""
        first, last = self.hold
        after = self.chunks - last
        if elapsed < last or length <= self.chunks:
            return min(elapsed, self.chunks - 1)
        if length - elapsed <= after:
            return self.chunks - (length - elapsed)
        return first + (elapsed - last) % (last - first)

    def members(self, elapsed: int, length: int, codes: int) -> Float[Tensor, " K"]:
        """The set that is due: 1 for each code in it."""
        place, row = self.place(elapsed, length), torch.zeros(codes)
        if not self.guides:
            return row
        if self.is_set:
            row[list(self.codes)] = 1.0
            return row
        tokens = self.chunk.tokens
        near = slice(max(0, place - REACH) * tokens, (place + REACH + 1) * tokens)
        row[list(self.codes[near])] = 1.0
        return row

    def overlay_at(self, elapsed: int, length: int, intensity: float) -> Overlay | None:
        """What is put on top of the chunk that is due."""
        if self.overlay is None:
            return None
        return self.overlay.chunk(self.place(elapsed, length), self.chunk).scaled(intensity)

    def to_json(self) -> dict[str, object]:
        """As in `actions.json`."""
        row: dict[str, object] = {"name": self.name, "about": self.about, "hold": self.hold}
        row |= {"codes": self.codes, "guides": self.guides} | ({"set": True} if self.is_set else {})
        return row if self.overlay is None else row | {"overlay": self.overlay.to_json()}

    @classmethod
    def from_json(cls, row: dict[str, Any], chunk: ChunkSize = CHUNK) -> Self:
        """The inverse of `to_json`; KeyError, TypeError or ValueError where something is missing or wrong."""
        first, last = row["hold"]
        overlay = Overlay.from_json(row["overlay"]) if "overlay" in row else None
        codes = tuple(int(code) for code in row["codes"])
        guides = bool(row["guides"])
        is_set = bool(row.get("set", False))
        name, hold, about = str(row["name"]), (int(first), int(last)), str(row["about"])
        return cls(name, codes, hold, about, guides, overlay, is_set, chunk)


@dataclass(frozen=True)
class ActionLibrary(Mapping[str, Action]):
    """Actions by name, in the order they were added."""

    actions: Mapping[str, Action] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Action:
        return self.actions[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.actions)

    def __len__(self) -> int:
        return len(self.actions)

    def find(self, name: str) -> Action:
        """The action of that name; case, blanks and hyphens do not matter.

        Raises:
            EchoAvatarError: there is none; the message lists those there are.
        """
        wanted = "_".join(name.lower().replace("-", " ").replace("_", " ").split())
        if wanted not in self.actions:
            known = ", ".join(self.actions) or "none: this bundle has no actions.json"
            raise EchoAvatarError(f"no action {name!r}; there are: {known}")
        return self.actions[wanted]

    def with_action(self, action: Action) -> "ActionLibrary":
        """The library with one action more, or another one under its name."""
        return ActionLibrary({**self.actions, action.name: action})

    def save(self, folder: Path) -> None:
        """Write `actions.json`."""
        rows = [action.to_json() for action in self.actions.values()]
        lines = ",\n".join("  " + json.dumps(row) for row in rows)
        partial = folder / f"{FILE}.partial"
        partial.write_text('{"version": 1, "actions": [\n' + lines + "\n]}\n")
        partial.replace(folder / FILE)

    @classmethod
    def load(cls, folder: Path, codes: int, chunk: ChunkSize = CHUNK) -> "ActionLibrary":
        """Read `actions.json`, where the folder has one; every code must be one of `codes`, a chunk is the bundle's.

        Raises:
            CheckpointError: the file is damaged, or made for another tokenizer.
        """
        path = folder / FILE
        if not path.exists():
            return cls()
        check_file(path, CONFIG_BYTES, CheckpointError)
        try:
            rows = json.loads(path.read_text())["actions"]
            actions = [Action.from_json(row, chunk) for row in rows]
        except (ValueError, LookupError, TypeError, RecursionError) as error:
            raise CheckpointError(f"{path} is not a library of actions ({error!r}); make it again") from error
        for action in actions:
            whole = action.overlay is None or len(action.overlay.rotation_vectors) == action.chunks * chunk.frames
            first, last = action.hold
            fits = 0 <= first < last <= action.chunks and all(0 <= code < codes for code in action.codes)
            if not (fits and whole):
                raise CheckpointError(
                    f"{path}: action {action.name!r} was made for another tokenizer; `echoavatar actions add` it again"
                )
        return cls({action.name: action for action in actions})
