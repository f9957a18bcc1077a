"""List the tools of a running server and call them in one of its sessions."""

import asyncio
import json
import urllib.error
import urllib.request
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote, urlsplit, urlunsplit

from echoavatar.errors import EchoAvatarError

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
        data = None
        if body is not None:
            data, headers["content-type"] = json.dumps(body).encode(), "application/json"
        request = urllib.request.Request(self.base + path, data, headers)
        try:
            with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
                return json.load(answer)
        except urllib.error.HTTPError as error:
            raise EchoAvatarError(f"{self.base} refused: {_reason(error)}") from error
        except (OSError, ValueError) as error:
            raise ConnectionLostError(
                f"no avatar server answers at {self.base} ({type(error).__name__}); start one with `echoavatar serve`"
            ) from error


def _reason(error: urllib.error.HTTPError) -> str:
    try:
        return str(json.load(error)["error"])
    except (OSError, ValueError, KeyError, TypeError):
        return f"HTTP {error.code}"
