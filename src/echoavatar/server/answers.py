"""`action_status` messages for actions and music."""

from echoavatar.wire import ActionState, ActionStatus


def answer(
    id: str, name: str, status: ActionState, at: int, *, reason: str = "", choices: tuple[str, ...] = ()
) -> ActionStatus:
    """A status of something that was asked for."""
    return ActionStatus(id=id, name=name, status=status, at=at, reason=reason, choices=choices)


class TrackWatch:
    """Follows the track that plays: accepted, started, done. Each method returns the statuses to send."""

    def __init__(self) -> None:
        self.title = ""  # empty: nothing plays
        self._id = ""
        self._is_heard = False

    def ask(self, id: str, title: str, at: int) -> list[ActionStatus]:
        """A track is to play, in place of the one that plays."""
        ended = self._end(at, "another track was asked for")
        self.title, self._id, self._is_heard = title, id, False
        return [*ended, answer(id, title, "accepted", at)]

    def follow(self, at: int, *, has_music: bool) -> list[ActionStatus]:
        """A chunk was sent, with music in it or without."""
        if has_music and self.title and not self._is_heard:
            self._is_heard = True
            return [answer(self._id, self.title, "started", at)]
        return self._end(at, "") if self._is_heard and not has_music else []

    def _end(self, at: int, reason: str) -> list[ActionStatus]:
        statuses = [answer(self._id, self.title, "done", at, reason=reason)] if self.title else []
        self.title, self._is_heard = "", False
        return statuses
