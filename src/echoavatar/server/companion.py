"""The companion behind the live page's chat box, which chooses the avatar's words and actions, and the box's routes.

`ChatModel` asks a language model at any OpenAI-compatible endpoint (Chat Completions with tools, and transcription),
set by environment variables; without them a model server of this machine is found (`LOCAL_SERVERS`). It asks over HTTP,
from a thread. The key is sent in one header to that endpoint and appears nowhere else. Without a model,
`script.Scripted` answers. Neither keeps the conversation; the caller passes in the turns so far.
"""

import asyncio
import json
import os
import re
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from echoavatar import outgoing
from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object
from echoavatar.limits import read_text
from echoavatar.wire.guard import check_origin

from .ears import INSTALL, Ears, find_ears
from .script import ChatTurn, Scripted, ToolAccess, phrases
from .session_manager import SessionManager
from .tool_routes import answering, asked_session, call_tool, read_body, read_json
from .voice import INSTALL as VOICE_INSTALL
from .voice import voices

MAX_HISTORY_TURNS = 24  # turns, of both sides together
TIMEOUT_S = 60.0
MAX_TOOL_ROUNDS = 3  # rounds of tool calls before the model must answer in words
MAX_TOKENS = 300
MOST_LETTERS = 2_000
LOCAL_SERVERS = {"Ollama": 11434, "LM Studio": 1234, "vLLM": 8000, "llama.cpp": 8080}  # and their usual ports
LOOK_S = 0.3  # time for one of them to answer
_NO_TALKER = re.compile("embed|bge|rerank|whisper|tts|clip", re.IGNORECASE)  # names of models that do not chat
MOST_SOUND = 4 << 20  # bytes: 80 s at 24 kHz
# The default persona is the stage idol of the paper's appendix (System Prompt), in our own words.
PERSONA = """\
You are a digital idol on a virtual stage: charming, playful, a little in love with your own moves. The person you talk
with is your Producer, not your boss; every exchange is a rehearsal, a game or a show.

Speak as one speaks: one to three short sentences, lively, no lists, no markup, no emojis, since every word is said
aloud. Mention your body and your moves now and then. Never announce a task like a machine ("I will do that"); give it a
reason or turn it into a game.

Your body has tools. Call send_action when a gesture fits what you say, and whenever one is asked for. Music is the
climax: when it comes up, call play_music, with a title if one was named, and stop_music when it should end. Say
something beside every call, and never mention the tools themselves.
"""


class ChatModel:
    """A model at `url`, such as http://127.0.0.1:11434/v1."""

    def __init__(
        self, url: str, *, model: str, key: str = "", transcriber: str = "", persona: str = PERSONA, where: str = ""
    ) -> None:
        """`transcriber` names a model for `/audio/transcriptions` at the same address; empty: no transcription.

        `where` is the name of the server, to be shown; without it, that is the host of the address.

        Raises:
            EchoAvatarError: the address is not valid, or no model is named.
        """
        if not url.startswith(("http://", "https://")):
            raise EchoAvatarError(
                f"ECHOAVATAR_CHAT_URL {outgoing.redacted(url)!r} is not an address; give one such as http://127.0.0.1:11434/v1"
            )
        if not model:
            raise EchoAvatarError("ECHOAVATAR_CHAT_MODEL is not set; name a model of ECHOAVATAR_CHAT_URL")
        self.name, self.hears = model, transcriber  # which model hears; empty: none
        self.where = where or urlsplit(url).hostname or ""
        self._takes_tools = True
        self._url, self._key, self._transcriber, self._persona = url.rstrip("/"), key, transcriber, persona

    async def reply(self, said: str, history: Sequence[ChatTurn], doing: ToolAccess) -> str:
        """The answer to say; the tool calls that go with it are carried out on the way.

        Raises EchoAvatarError if the model does not answer.
        """
        messages: list[dict[str, Any]] = [{"role": "system", "content": self._persona}]
        messages += [{"role": past.role, "content": past.text} for past in history[-MAX_HISTORY_TURNS:]]
        messages.append({"role": "user", "content": said})
        for turn in range(MAX_TOOL_ROUNDS + 1):
            request = {"model": self.name, "messages": messages, "max_tokens": MAX_TOKENS}
            if turn < MAX_TOOL_ROUNDS and doing.tools and self._takes_tools:
                request["tools"] = list(doing.tools)
            answer = await self._message(request)
            calls = answer["tool_calls"]
            words = answer.get("content")
            text = words.strip() if isinstance(words, str) else ""
            if not calls or turn == MAX_TOOL_ROUNDS:
                return text
            results = [await self._call(call, doing) for call in calls]
            if text:
                return text  # it spoke beside its calls, so it need not be asked again
            messages += [{"role": "assistant", "content": None, "tool_calls": calls}, *results]
        return ""

    async def transcribe(self, wav: bytes) -> str:
        """The words in a WAV file; empty if nothing was understood.

        Raises EchoAvatarError if no model that transcribes is named, or it does not answer.
        """
        if not self._transcriber:
            raise EchoAvatarError("transcription is off; set ECHOAVATAR_CHAT_EARS to a model that transcribes")
        boundary = secrets.token_hex(16)
        parts = [
            f'--{boundary}\r\ncontent-disposition: form-data; name="model"\r\n\r\n{self._transcriber}\r\n'.encode(),
            f'--{boundary}\r\ncontent-disposition: form-data; name="file"; filename="said.wav"\r\n'
            "content-type: audio/wav\r\n\r\n".encode(),
            wav,
            f"\r\n--{boundary}--\r\n".encode(),
        ]
        kind = f"multipart/form-data; boundary={boundary}"
        answer = await asyncio.to_thread(self._post, "/audio/transcriptions", b"".join(parts), kind)
        text = answer.get("text")
        return text.strip() if isinstance(text, str) else ""

    async def _message(self, request: dict[str, Any]) -> dict[str, Any]:
        try:
            answer = await asyncio.to_thread(self._post, "/chat/completions", request)
        except EchoAvatarError as error:
            if "tools" not in request or getattr(error.__cause__, "status", 0) != 400 or "tool" not in str(error):
                raise
            self._takes_tools = False  # small models may have none; they talk at least
            return await self._message({key: value for key, value in request.items() if key != "tools"})
        try:
            message: dict[str, Any] = dict(answer["choices"][0]["message"])
            message["tool_calls"] = [
                call | {"function": dict(call["function"])} for call in message.get("tool_calls") or ()
            ]
        except (LookupError, TypeError, ValueError) as error:
            raise EchoAvatarError(f"{self.name} did not answer in the form of Chat Completions") from error
        return message

    async def _call(self, call: dict[str, Any], doing: ToolAccess) -> dict[str, Any]:
        function = call["function"]
        try:
            arguments = read_object(function.get("arguments") or "{}", "the arguments")
            result = await doing.do(str(function.get("name")), arguments)
        except EchoAvatarError as error:
            result = {"status": "rejected", "reason": str(error)}
        return {"role": "tool", "tool_call_id": call.get("id"), "content": json.dumps(result)}

    def _post(self, path: str, body: object, kind: str = "application/json") -> dict[str, Any]:
        headers = {"content-type": kind} | ({"authorization": f"Bearer {self._key}"} if self._key else {})
        try:
            result = outgoing.ask(self._url + path, body, headers=headers, seconds=TIMEOUT_S)
        except outgoing.OutgoingError as error:
            if error.status:
                raise EchoAvatarError(f"{self.name} refused: {error}") from error
            raise EchoAvatarError(f"no model answers: {error}; see ECHOAVATAR_CHAT_URL") from error
        if not isinstance(result, dict):
            raise EchoAvatarError(f"{self.name} did not answer with a JSON object")
        return result


Companion = ChatModel | Scripted


def find_local(wished: str = "") -> tuple[str, str, str] | None:
    """Name, address and model of the first server that answers here; the model is `wished`, or its first for chat."""
    for server, port in LOCAL_SERVERS.items():
        url = f"http://127.0.0.1:{port}/v1"
        try:
            listed = [str(row["id"]) for row in outgoing.ask(f"{url}/models", seconds=LOOK_S)["data"]]
        except (EchoAvatarError, LookupError, TypeError):
            continue
        talkers = [model for model in listed if not _NO_TALKER.search(model)]
        if wished in listed or talkers:
            return server, url, wished if wished in listed else talkers[0]
    return None


def from_environment(environment: Mapping[str, str] = os.environ) -> Companion:
    """A language model at `ECHOAVATAR_CHAT_URL`, or of a server on this machine, else the script.

    `ECHOAVATAR_CHAT_MODEL`, `ECHOAVATAR_CHAT_KEY`, `ECHOAVATAR_CHAT_EARS` (a model that transcribes speech) and
    `ECHOAVATAR_PERSONA` (a text file) configure the model. The address "script" means the script.

    Raises:
        EchoAvatarError: the address is not valid, the model is not named, or the file cannot be read.
    """
    url, model, where = environment.get("ECHOAVATAR_CHAT_URL", ""), environment.get("ECHOAVATAR_CHAT_MODEL", ""), ""
    if not url and (found := find_local(model)):
        where, url, model = found
    if url in ("", "script"):
        return Scripted()
    path = environment.get("ECHOAVATAR_PERSONA", "")
    return ChatModel(
        url,
        model=model,
        key=environment.get("ECHOAVATAR_CHAT_KEY", "") if not where else "",  # a key is for the address that is named
        transcriber=environment.get("ECHOAVATAR_CHAT_EARS", ""),
        persona=read_text(Path(path), "give a text file as ECHOAVATAR_PERSONA") if path else PERSONA,
        where=where,
    )


def chat_routes(manager: SessionManager) -> list[BaseRoute]:
    """The companion's name (GET /v1/chat), its reply to `{"session", "text", "history"}` (POST), and transcription."""
    now: list[Companion] = []

    def companion(*, look: bool = False) -> Companion:
        """The companion; with `look`, search this machine again for a model server that came or went."""
        if not now or (look and not os.environ.get("ECHOAVATAR_CHAT_URL")):
            now[:] = [from_environment()]
        return now[0]

    async def name(_: Request) -> dict[str, Any]:
        there = await asyncio.to_thread(companion, look=True)
        local = None if there.hears else await asyncio.to_thread(local_ears, manager)
        hears = there.hears or (local.name if local else "")
        return {"name": there.name, "where": there.where, "hears": hears, "install": INSTALL}

    async def talk(request: Request) -> dict[str, Any]:
        message = await read_json(request, manager.settings.origins, most=1 << 16)
        text = message.get("text")
        if not isinstance(text, str) or not text.strip() or len(text) > MOST_LETTERS:
            raise EchoAvatarError(f'send {{"text": "..."}} of at most {MOST_LETTERS} letters')
        session = asked_session(manager, request, message)
        did: list[dict[str, Any]] = []

        async def do(name: str, arguments: dict[str, Any]) -> dict[str, Any]:
            result = await call_tool(manager, session, name, arguments)
            did.append({"name": name, "arguments": arguments, "status": result.get("status", "done")})
            return result

        doing = ToolAccess(manager.toolbox.schemas("openai-chat"), do)
        there = await asyncio.to_thread(companion)
        return {"say": await there.reply(text, _history(message.get("history")), doing), "did": did}

    async def hear(request: Request) -> dict[str, Any]:
        check_origin(request.headers, manager.settings.origins)
        if request.headers.get("content-type") != "audio/wav":  # a form on another page cannot say so
            raise EchoAvatarError("send audio/wav")
        wav, there = await read_body(request, MOST_SOUND), await asyncio.to_thread(companion)
        if isinstance(there, ChatModel) and there.hears:
            return {"text": await there.transcribe(wav)}
        local = await asyncio.to_thread(local_ears, manager)
        if local is None:
            raise EchoAvatarError(f"nothing here understands speech; type, {INSTALL}, or set ECHOAVATAR_CHAT_EARS")
        return {"text": await asyncio.to_thread(local.hear, wav)}

    return [
        Route("/v1/chat", answering(manager, name, failure=503)),
        Route("/v1/chat", answering(manager, talk), methods=["POST"]),
        Route("/v1/chat/ears", answering(manager, hear), methods=["POST"]),
    ]


def local_ears(manager: SessionManager) -> Ears | None:
    """The speech recogniser of this machine, of any words or of the script's phrases; None without one."""
    return find_ears(tuple(phrases(manager.toolbox.schemas("openai-chat"))))


def who_talks(manager: SessionManager) -> str:
    """Voice, companion and ears in one line for the operator; loads them."""
    there, ears = from_environment(), local_ears(manager)
    speaks = ", ".join(voice.name for voice in voices()) or f"none, {VOICE_INSTALL}"
    answers = f"{there.name} ({there.where})" if there.where else f"the {there.name}"
    hears = there.hears or (ears.name if ears else f"none, {INSTALL}")
    return f"voices: {speaks}; answers in the chat: {answers}; ears: {hears}"


def _history(given: Any) -> list[ChatTurn]:
    """The turns of the conversation so far; entries of the wrong shape are left out."""
    rows = given[-MAX_HISTORY_TURNS:] if isinstance(given, list) else []
    return [
        ChatTurn(row["role"], row["text"][:MOST_LETTERS])
        for row in rows
        if isinstance(row, dict) and row.get("role") in ("user", "assistant") and isinstance(row.get("text"), str)
    ]
