"""Refused requests: a refusal becomes a `Problem` of the API."""

from echoavatar.errors import EchoAvatarError

from .wire import STATUS, ErrorCode, Problem


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


def not_found() -> StudioError:
    """The same answer for a thing that does not exist and for one that belongs to somebody else."""
    return StudioError("not_found", "there is no such thing here")
