"""What became of what was asked for: statuses of actions and music."""

from collections.abc import Callable

from ..wire import ActionState, ActionStatus


def answer(
    id: str, name: str, status: ActionState, at: int, *, reason: str = "", choices: tuple[str, ...] = ()
) -> ActionStatus:
    """What became of something that was asked for."""
    return ActionStatus(id=id, name=name, status=status, at=at, reason=reason, choices=choices)


class TrackWatch:
    """Tells of the track that plays: accepted, started, done."""

    def __init__(self, tell: Callable[[ActionStatus], None]) -> None:
        self.title = ""  # empty: nothing plays
        self._tell = tell
        self._id = ""
        self._is_heard = False

    def asked(self, id: str, title: str, at: int) -> None:
        """A track is to play, instead of what plays."""
        self._end(at, "another track was asked for")
        self.title, self._id, self._is_heard = title, id, False
        self._tell(answer(id, title, "accepted", at))

    def follow(self, at: int, *, has_music: bool) -> None:
        """A chunk went out, with music in it or without."""
        if has_music and self.title and not self._is_heard:
            self._is_heard = True
            self._tell(answer(self._id, self.title, "started", at))
        elif not has_music and self._is_heard:
            self._end(at, "")

    def _end(self, at: int, reason: str) -> None:
        if self.title:
            self._tell(answer(self._id, self.title, "done", at, reason=reason))
        self.title, self._is_heard = "", False
