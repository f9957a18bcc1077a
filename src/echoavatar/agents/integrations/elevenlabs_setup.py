"""Create what an ElevenLabs agent needs to move an avatar - tools, prompt, sound format - through their HTTP API.

Running it again changes nothing: tools and agent are found by name and updated. It does not need their SDK.
"""

from collections.abc import Iterator
from copy import deepcopy
from typing import Any, NamedTuple
from urllib.parse import quote, urlencode

from echoavatar import outgoing
from echoavatar.engine.tools import render
from echoavatar.errors import EchoAvatarError

Payload = dict[str, Any]
BASE_URL = "https://api.elevenlabs.io"
FORMATS = ("pcm_8000", "pcm_16000", "pcm_22050", "pcm_24000", "pcm_44100", "pcm_48000")
TIMEOUT_S = 30.0
MOST_PAGES = 100  # most pages of a list
MOST_LETTERS = 200  # most letters of an id or a name


class Plan(NamedTuple):
    """The requests to send."""

    tools: list[Payload]
    agent: Payload  # without the ids of its tools, which are known once the tools exist


def make_plan(
    schemas: list[Payload], prompt: str, *, name: str, first_message: str = "", output_format: str = "pcm_16000"
) -> Plan:
    """Build the requests for the avatar's tools and for an agent that uses them.

    Raises:
        EchoAvatarError: the sound format is not supported.
    """
    if output_format not in FORMATS:
        raise EchoAvatarError(f"output format {output_format!r} is not supported; give one of {', '.join(FORMATS)}")
    agent: Payload = {"prompt": {"prompt": prompt}, "language": "en"}
    if first_message:
        agent["first_message"] = first_message
    config = {"agent": agent, "tts": {"agent_output_audio_format": output_format}}
    return Plan(render("elevenlabs", schemas), {"name": name, "conversation_config": config})


def carry_out(plan: Plan, *, api_key: str, agent_id: str = "", base_url: str = BASE_URL) -> tuple[str, list[str]]:
    """Create or update tools and agent; returns the agent's id and one line for each thing done.

    Raises:
        EchoAvatarError: the service refused a request, or cannot be reached.
    """
    service = _Service(base_url, api_key)
    known = {_text(tool, "tool_config", "name"): _text(tool, "id") for tool in service.all("/v1/convai/tools", "tools")}
    ids, done = [], []
    for tool in plan.tools:
        name = tool["tool_config"]["name"]
        if name in known:
            service.call("PATCH", f"/v1/convai/tools/{quote(known[name], safe='')}", tool)
            ids.append(known[name])
        else:
            ids.append(_text(service.call("POST", "/v1/convai/tools", tool), "id"))
        done.append(f"{'updated' if name in known else 'created'} tool {name} ({ids[-1]})")
    agent = deepcopy(plan.agent)
    agent["conversation_config"]["agent"]["prompt"]["tool_ids"] = ids
    if not agent_id:
        found = service.all("/v1/convai/agents", "agents", search=agent["name"])
        agent_id = next((_text(one, "agent_id") for one in found if one.get("name") == agent["name"]), "")
    if agent_id:
        service.call("PATCH", f"/v1/convai/agents/{quote(agent_id, safe='')}", agent)
        done.append(f"updated agent {agent['name']} ({agent_id})")
    else:
        agent_id = _text(service.call("POST", "/v1/convai/agents/create", agent), "agent_id")
        done.append(f"created agent {agent['name']} ({agent_id})")
    return agent_id, done


class _Service:
    def __init__(self, base_url: str, api_key: str) -> None:
        self._base, self._key = base_url.rstrip("/"), api_key

    def call(self, method: str, path: str, body: Payload | None = None) -> Payload:
        """Send one request."""
        headers = {"xi-api-key": self._key}
        try:
            result = outgoing.ask(self._base + path, body, headers=headers, method=method, seconds=TIMEOUT_S)
        except outgoing.OutgoingError as error:
            hint = "; is the API key right?" if error.status in (401, 403) else ""
            raise EchoAvatarError(f"{method}: {error}{hint}") from error
        if not isinstance(result or {}, dict):
            raise EchoAvatarError(f"{method} {path}: the answer is not a JSON object")
        return result or {}

    def all(self, path: str, key: str, **query: str) -> Iterator[Payload]:
        """Every item of a list, page by page."""
        for _ in range(MOST_PAGES):
            result = self.call("GET", f"{path}?{urlencode({**query, 'page_size': 100})}")
            items = result.get(key)
            yield from (item for item in (items if isinstance(items, list) else ()) if isinstance(item, dict))
            if not result.get("has_more") or not result.get("next_cursor"):
                return
            query["cursor"] = str(result["next_cursor"])
        raise EchoAvatarError(f"GET {path}: the list has more than {MOST_PAGES} pages; is this ElevenLabs?")


def _text(answer: Any, *keys: str) -> str:
    """The text at these keys of an answer."""
    for key in keys:
        answer = answer.get(key) if isinstance(answer, dict) else None
    if not isinstance(answer, str) or not 0 < len(answer) <= MOST_LETTERS or not answer.isprintable():
        raise EchoAvatarError(f"the service's answer has no usable {' '.join(keys)}; is this ElevenLabs?")
    return answer
