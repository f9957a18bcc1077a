"""List the tools of a running server and call them in one of its sessions."""

import asyncio
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote, urlsplit, urlunsplit

from echoavatar import outgoing
from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object

from .connection import ConnectionLostError, stream_url

TIMEOUT_S = 20.0


class RemoteTools:
    """The tools of the server at `url`; calls act on `session` (a public name; empty: the newest)."""

    def __init__(self, url: str, *, token: str = "", session: str = "") -> None:
        parts = urlsplit(stream_url(url))
        scheme = {"ws": "http", "wss": "https"}[parts.scheme]
        self.base = urlunsplit((scheme, parts.netloc, "", "", ""))
        self._token, self.session = token, session

    def schemas(self, style: str = "plain") -> list[dict[str, Any]]:
        """The tools' declarations in the form that a framework expects.

        Raises:
            EchoAvatarError: the server does not answer, or refuses the request.
        """
        answer: list[dict[str, Any]] = self._ask(f"/v1/tools?style={quote(style)}")
        return answer

    def sessions(self) -> list[str]:
        """Public names of the sessions, the oldest first.

        Raises:
            EchoAvatarError: the server does not answer, or refuses the request.
        """
        return [str(name) for name in self._ask("/v1/sessions")["sessions"]]

    def call(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Call a tool. A call that fails returns the status `rejected`; nothing is raised."""
        try:
            answer: dict[str, Any] = self._ask(
                f"/v1/tools/{quote(name, safe='')}", {"session": self.session, "arguments": dict(arguments)}
            )
        except EchoAvatarError as error:
            return {"status": "rejected", "reason": str(error)}
        return answer

    async def call_async(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """`call`, without blocking the event loop."""
        return await asyncio.to_thread(self.call, name, arguments)

    def _ask(self, path: str, body: object = None) -> Any:
        headers = {"authorization": f"Bearer {self._token}"} if self._token else {}
        try:
            return outgoing.ask(self.base + path, body, headers=headers, seconds=TIMEOUT_S)
        except outgoing.OutgoingError as error:
            if error.status == 404 and body is not None and not self.session:
                raise EchoAvatarError(f"no session yet: open {self.base} in a browser, then call again") from error
            if error.status:
                raise EchoAvatarError(f"{outgoing.redacted(self.base)} refused: {_reason(error)}") from error
            raise ConnectionLostError(
                f"no avatar server answers: {error}; start one with `echoavatar serve`"
            ) from error


def _reason(error: outgoing.OutgoingError) -> str:
    """Why our server refused a request; HTTP's status if another server did."""
    try:
        return str(read_object(error.said, "the refusal")["error"])
    except (EchoAvatarError, KeyError):
        return str(error)
