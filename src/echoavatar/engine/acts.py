"""Actions of one session in time: asked for, accepted, started, done; one at a time, each with an end.

Times are chunks of the session's own clock, so what a chunk is told depends on its number alone and a session that is
rewound is told the same again.
"""

from collections import deque
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from ..errors import EchoAvatarError
from ..pipeline.action_overlay import Overlay, joined
from ..pipeline.actions import Action, ActionLibrary
from ..timing import CHUNK, ChunkSize

Status = Literal["accepted", "started", "done", "rejected"]
KEPT = 64  # actions and statuses that nobody asked about
STRONGEST = 2.0  # intensity


class ActStatus(NamedTuple):
    """What became of an action."""

    id: str
    name: str
    status: Status
    at: int  # sample of the session at which it holds
    reason: str = ""  # why it was rejected or ended early


@dataclass(frozen=True)
class Act:
    """An action that has its place in time."""

    id: str
    action: Action
    intensity: float
    begin: int  # chunk
    length: int  # chunks
    reason: str = ""  # why it ends early
    is_own: bool = False  # nobody asked for it

    @property
    def end(self) -> int:
        """The chunk after its last."""
        return self.begin + self.length


class Acts:
    """The actions of one session."""

    def __init__(self, library: ActionLibrary, chunk: ChunkSize = CHUNK) -> None:
        self._library, self._size = library, chunk.samples
        self._acts: deque[Act] = deque(maxlen=KEPT)
        self._statuses: deque[ActStatus] = deque(maxlen=4 * KEPT)
        self._told: set[tuple[str, Status]] = set()
        self._quiet: set[str] = set()  # ids of which nothing is told
        self._number = 0

    def ask(
        self,
        name: str,
        *,
        chunk: int,
        intensity: float = 1.0,
        hold_s: float | None = None,
        id: str = "",
        is_own: bool = False,
    ) -> ActStatus:
        """Begin an action with the given chunk; one that runs then ends there. Never raises: it may be rejected.

        Of what the avatar does by itself (`is_own`) nothing is told.
        """
        self._number += 1
        id = id or f"action-{self._number}"
        try:
            action = self._library.find(name)
            if any(act.id == id for act in self._acts):
                raise EchoAvatarError(f"action id {id!r} was used already; give each request its own")
            if not 0 < intensity <= STRONGEST:
                raise EchoAvatarError(f"intensity {intensity:g} is not in 0..{STRONGEST:g}")
            if hold_s is not None and not 0 <= hold_s < float("inf"):
                raise EchoAvatarError(f"hold {hold_s:g} is not a number of seconds")
        except EchoAvatarError as error:
            rejected = ActStatus(id, name, "rejected", chunk * self._size, str(error))
            if not is_own:
                self._statuses.append(rejected)
            return rejected
        self._end_at(chunk, f"{action.name} was asked for")
        if is_own:
            self._quiet.add(id)
        self._acts.append(Act(id, action, intensity, chunk, action.length(hold_s), is_own=is_own))
        return self._tell(ActStatus(id, action.name, "accepted", chunk * self._size))

    def knows(self, name: str) -> bool:
        """Whether there is such an action."""
        try:
            return bool(self._library.find(name))
        except EchoAvatarError:
            return False

    def stop(self, chunk: int) -> None:
        """End what runs with the given chunk."""
        self._end_at(chunk, "stopped")

    def running(self, chunk: int) -> Act | None:
        """The action that holds during a chunk."""
        return next((act for act in reversed(self._acts) if act.begin <= chunk < act.end), None)

    def members(self, chunk: int, codes: int) -> Float[Tensor, " K"] | None:
        """What a chunk is told: the intensity of each code of the set that is due."""
        act = self.running(chunk)
        if act is None:
            return None
        edge = 0.7 if chunk in (act.begin, act.end - 1) and act.length > 2 else 1.0
        return act.action.members(chunk - act.begin, act.length, codes) * torch.tensor(act.intensity * edge)

    def overlay(self, chunk: int) -> Overlay | None:
        """What is put on top of a chunk's motion; it begins where that of the chunk before it ended."""
        (before, earlier), (now, place) = self._turns(chunk - 1), self._turns(chunk)
        return now if place == earlier + 1 else joined(before, now)

    def _turns(self, chunk: int) -> tuple[Overlay | None, int]:
        """What an action asks for, and a number that goes up by one while its clip goes on."""
        act = self.running(chunk)
        if act is None:
            return None, -1
        elapsed = chunk - act.begin
        place = act.action.place(elapsed, act.length) + 1000 * self._acts.index(act)
        return act.action.turns(elapsed, act.length, act.intensity), place

    def delivered(self, chunk: int) -> None:
        """A chunk of motion went out: its action has started, those that end with it are done."""
        for act in tuple(self._acts):
            if act.begin <= chunk and act.length > 0:
                self._tell(ActStatus(act.id, act.action.name, "started", act.begin * self._size))
            if act.end <= chunk + 1:
                self._tell(ActStatus(act.id, act.action.name, "done", act.end * self._size, act.reason))

    def take(self) -> list[ActStatus]:
        """Statuses since the last call, in order."""
        told = list(self._statuses)
        self._statuses.clear()
        return told

    def _end_at(self, chunk: int, reason: str) -> None:
        for place, act in enumerate(self._acts):
            if act.end > chunk:
                length = max(0, chunk - act.begin)
                self._acts[place] = replace(act, length=length, reason=reason)
                if length == 0:
                    self._tell(ActStatus(act.id, act.action.name, "done", chunk * self._size, reason))

    def _tell(self, status: ActStatus) -> ActStatus:
        """Each status once, also when a session is rewound and a chunk goes out again."""
        if status.id not in self._quiet and (status.id, status.status) not in self._told:
            self._told.add((status.id, status.status))
            self._statuses.append(status)
        if len(self._told) > 16 * KEPT:
            live = {act.id for act in self._acts}
            self._told = {told for told in self._told if told[0] in live}
            self._quiet &= live
        return status
