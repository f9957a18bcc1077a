"""Refused requests: a refusal becomes a `Problem` of the API."""

from echoavatar.errors import EchoAvatarError

from .wire import STATUS, ErrorCode, Problem

RETRY_S = 5.0  # a client may try again after this time while the store is away


class StudioError(EchoAvatarError):
    """A request was refused. The page gets `code`; changes of the same transaction are rolled back."""

    def __init__(self, code: ErrorCode, message: str, *, retry_after: float = 0.0) -> None:
        super().__init__(message)
        self.code, self.retry_after = code, retry_after

    @property
    def status(self) -> int:
        """The status of the HTTP answer."""
        return STATUS[self.code]

    @property
    def problem(self) -> Problem:
        """The body of the HTTP answer."""
        return Problem(code=self.code, message=str(self), retry_after=self.retry_after)


class StoreAwayError(StudioError):
    """The database or the disk is away; the same request succeeds when it is back. Pages repeat what is `busy`."""

    def __init__(self, reason: str) -> None:
        super().__init__("busy", "the studio cannot reach its data now; try again in a moment", retry_after=RETRY_S)
        self.reason = reason  # for the log, in one line

    @property
    def status(self) -> int:
        """503: Service Unavailable."""
        return 503


def not_found() -> StudioError:
    """The same answer for a thing that does not exist and for one that belongs to somebody else."""
    return StudioError("not_found", "there is no such thing here")
