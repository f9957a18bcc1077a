"""The actions of one session: accepted, started, done; one at a time, each with an end.

Times are chunks of the session's clock. The effect of an action on a chunk depends on the chunk's number alone, so a
session that goes back does the same again.
"""

from collections import deque
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.action_overlay import Overlay, bridge
from echoavatar.timing import CHUNK, ChunkSize

from .pipeline.actions import Action, ActionLibrary

Status = Literal["accepted", "started", "done", "rejected"]
KEPT = 64  # actions remembered
STRONGEST = 2.0  # intensity
EDGE, EDGE_S = 0.7, 0.26  # share of its intensity at an action's beginning and end, and for how long


class ActStatus(NamedTuple):
    """A change in the state of an action."""

    id: str
    name: str
    status: Status
    at: int  # sample of the session's clock
    reason: str = ""  # why it was rejected or ended early


@dataclass(frozen=True)
class ScheduledAction:
    """An action with its place on the session's clock."""

    id: str
    action: Action
    intensity: float
    begin: int  # chunk
    length: int  # chunks
    reason: str = ""  # why it ends early
    is_own: bool = False  # the avatar's own idea, not a request
    concept: str = ""  # the concept whose word asked for it, see `words`

    @property
    def end(self) -> int:
        """The chunk after its last."""
        return self.begin + self.length


class ActionScheduler:
    """The actions of one session."""

    def __init__(self, library: ActionLibrary, chunk: ChunkSize = CHUNK) -> None:
        self.library, self._size, self._edge = library, chunk.samples, chunk.within(EDGE_S)
        self._actions: deque[ScheduledAction] = deque(maxlen=KEPT)
        self._statuses: deque[ActStatus] = deque(maxlen=4 * KEPT)
        self._reported: set[tuple[str, Status]] = set()
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
        concept: str = "",
    ) -> ActStatus:
        """Begin an action with the given chunk, in place of the one that runs. Never raises: it may be rejected.

        The avatar's own actions (`is_own`) are not reported. `concept` is that of a word that asks. `hold_s`: seconds.
        """
        self._number += 1
        id = id or f"action-{self._number}"
        try:
            action = self.library.find(name)
            if any(act.id == id for act in self._actions):
                raise EchoAvatarError(f"action id {id!r} was used already; give each request its own")
            if not 0 < intensity <= STRONGEST:
                raise EchoAvatarError(f"intensity {_short(intensity)} is not in 0..{STRONGEST:g}")
            if hold_s is not None and not 0 <= hold_s < float("inf"):
                raise EchoAvatarError(f"hold {_short(hold_s)} is not a number of seconds")
        except EchoAvatarError as error:
            rejected = ActStatus(id, name, "rejected", chunk * self._size, str(error))
            if not is_own:
                self._statuses.append(rejected)
            return rejected
        self._end_at(chunk, f"{action.name} was asked for")
        length = action.length(hold_s)
        act = ScheduledAction(id, action, intensity, chunk, length, is_own=is_own, concept=concept)
        self._actions.append(act)
        return self._report(act, "accepted", chunk)

    def knows(self, name: str) -> bool:
        """Whether the library has such an action."""
        try:
            return bool(self.library.find(name))
        except EchoAvatarError:
            return False

    def stop(self, chunk: int) -> None:
        """End the running action before the given chunk."""
        self._end_at(chunk, "stopped")

    def gestures_before(self, chunk: int) -> list[ScheduledAction]:
        """The actions that words began before a chunk. Later ones are dropped: their words will ask again."""
        later = [act for act in self._actions if act.concept and act.begin >= chunk]
        for act in later:
            self._actions.remove(act)
        return [act for act in self._actions if act.concept]

    def running(self, chunk: int) -> ScheduledAction | None:
        """The action that runs during a chunk."""
        return next((act for act in reversed(self._actions) if act.begin <= chunk < act.end), None)

    def members(self, chunk: int, codes: int) -> Float[np.ndarray, " K"] | None:
        """The intensity of each motion code that the running action asks for in a chunk; None without an action."""
        act = self.running(chunk)
        if act is None:
            return None
        is_edge = min(chunk - act.begin, act.end - 1 - chunk) < self._edge and act.length > 2 * self._edge
        share = np.float32(act.intensity * (EDGE if is_edge else 1.0))
        return act.action.members(chunk - act.begin, act.length, codes) * share

    def overlay(self, chunk: int) -> Overlay | None:
        """The overlay for a chunk's motion, blended from that of the chunk before; None if neither has one."""
        (before, earlier), (now, place) = self._overlay_at(chunk - 1), self._overlay_at(chunk)
        return now if place == earlier + 1 else bridge(before, now)

    def _overlay_at(self, chunk: int) -> tuple[Overlay | None, int]:
        """The overlay of a chunk, and a number that goes up by one from chunk to chunk of the same clip."""
        act = self.running(chunk)
        if act is None:
            return None, -1
        elapsed = chunk - act.begin
        place = act.action.place(elapsed, act.length) + 1000 * self._actions.index(act)
        return act.action.overlay_at(elapsed, act.length, act.intensity), place

    def report_made(self, chunk: int) -> None:
        """A chunk of motion was made: its action has started, and those that end with it are done."""
        for act in tuple(self._actions):
            if act.begin <= chunk and act.length > 0:
                self._report(act, "started", act.begin)
            if act.end <= chunk + 1:
                self._report(act, "done", act.end)

    def take(self) -> list[ActStatus]:
        """Statuses since the last call, in order."""
        statuses = list(self._statuses)
        self._statuses.clear()
        return statuses

    def _end_at(self, chunk: int, reason: str) -> None:
        for place, act in enumerate(self._actions):
            if act.end > chunk:
                ended = self._actions[place] = replace(act, length=max(0, chunk - act.begin), reason=reason)
                if ended.length == 0:
                    self._report(ended, "done", chunk)

    def _report(self, act: ScheduledAction, status: Status, chunk: int) -> ActStatus:
        """Report each status once, even if a chunk is made again."""
        told = ActStatus(act.id, act.action.name, status, chunk * self._size, act.reason if status == "done" else "")
        if not act.is_own and (act.id, status) not in self._reported:
            self._reported.add((act.id, status))
            self._statuses.append(told)
        if len(self._reported) > 16 * KEPT:
            live = {act.id for act in self._actions}
            self._reported = {known for known in self._reported if known[0] in live}
        return told


def _short(value: float) -> str:
    """A number for a message; an integer may have hundreds of digits."""
    return repr(value)[:20]
