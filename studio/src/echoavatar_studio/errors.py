"""Refusals: what becomes of a request that must not be done, as a `Problem` of the API."""

from echoavatar.errors import EchoAvatarError

from .wire import STATUS, ErrorCode, Problem


class StudioError(EchoAvatarError):
    """Not done, and why; `code` is told to the page. Changes of the same transaction are undone."""

    def __init__(self, code: ErrorCode, message: str, *, retry_after: float = 0.0) -> None:
        super().__init__(message)
        self.code, self.retry_after = code, retry_after

    @property
    def status(self) -> int:
        """Of the HTTP answer."""
        return STATUS[self.code]

    @property
    def problem(self) -> Problem:
        """What the page is told."""
        return Problem(code=self.code, message=str(self), retry_after=self.retry_after)


def not_found() -> StudioError:
    """One answer for what does not exist and for what is somebody else's."""
    return StudioError("not_found", "there is no such thing here")
