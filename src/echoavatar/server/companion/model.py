"""A language model at an OpenAI-compatible endpoint: Chat Completions with tools, and transcription.

It uses plain HTTP from a thread and needs no package. The key is sent in one header and appears nowhere else.
"""

import asyncio
import json
import secrets
import urllib.error
import urllib.request
from collections.abc import Sequence
from typing import Any

from echoavatar.errors import EchoAvatarError

from .talk import MAX_HISTORY_TURNS, ChatTurn, ToolAccess

TIMEOUT_S = 60.0
MAX_TOOL_ROUNDS = 3  # rounds of tool calls before the model must answer in words
MAX_TOKENS = 300
MAX_ANSWER_BYTES = 1 << 22
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

    def __init__(self, url: str, *, model: str, key: str = "", transcriber: str = "", persona: str = PERSONA) -> None:
        """`transcriber` names a model for `/audio/transcriptions` at the same address; empty: no transcription.

        Raises:
            EchoAvatarError: the address is not valid, or no model is named.
        """
        if not url.startswith(("http://", "https://")):
            raise EchoAvatarError(
                f"ECHOAVATAR_CHAT_URL {url!r} is not an address; give one such as http://127.0.0.1:11434/v1"
            )
        if not model:
            raise EchoAvatarError("ECHOAVATAR_CHAT_MODEL is not set; name a model of ECHOAVATAR_CHAT_URL")
        self.name, self.hears = model, bool(transcriber)
        self._url, self._key, self._transcriber, self._persona = url.rstrip("/"), key, transcriber, persona

    async def reply(self, said: str, history: Sequence[ChatTurn], doing: ToolAccess) -> str:
        """The model's answer; its tool calls are carried out on the way."""
        messages: list[dict[str, Any]] = [{"role": "system", "content": self._persona}]
        messages += [{"role": past.role, "content": past.text} for past in history[-MAX_HISTORY_TURNS:]]
        messages.append({"role": "user", "content": said})
        for turn in range(MAX_TOOL_ROUNDS + 1):
            request = {"model": self.name, "messages": messages, "max_tokens": MAX_TOKENS}
            if turn < MAX_TOOL_ROUNDS and doing.tools:
                request["tools"] = list(doing.tools)
            answer = await self._message(request)
            calls = answer.get("tool_calls") or []
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
        """Transcribe a WAV file."""
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
        body = json.dumps(request).encode()
        answer = await asyncio.to_thread(self._post, "/chat/completions", body, "application/json")
        try:
            message: dict[str, Any] = answer["choices"][0]["message"]
        except (KeyError, IndexError, TypeError) as error:
            raise EchoAvatarError(f"{self.name} did not answer in the form of Chat Completions") from error
        return message

    async def _call(self, call: dict[str, Any], doing: ToolAccess) -> dict[str, Any]:
        function = call.get("function") or {}
        try:
            arguments = json.loads(function.get("arguments") or "{}")
        except (ValueError, TypeError):
            arguments = None
        if isinstance(arguments, dict):
            result = await doing.do(str(function.get("name")), arguments)
        else:
            result = {"status": "rejected", "reason": "the arguments are not a JSON object"}
        return {"role": "tool", "tool_call_id": call.get("id"), "content": json.dumps(result)}

    def _post(self, path: str, body: bytes, kind: str) -> dict[str, Any]:
        headers = {"content-type": kind}
        if self._key:
            headers["authorization"] = f"Bearer {self._key}"
        request = urllib.request.Request(self._url + path, body, headers)
        try:
            with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
                result = json.loads(answer.read(MAX_ANSWER_BYTES))
        except urllib.error.HTTPError as error:
            raise EchoAvatarError(f"{self.name} refused: HTTP {error.code}") from error
        except (OSError, ValueError) as error:
            raise EchoAvatarError(
                f"no model answers at {self._url} ({type(error).__name__}); see ECHOAVATAR_CHAT_URL"
            ) from error
        if not isinstance(result, dict):
            raise EchoAvatarError(f"{self.name} did not answer with a JSON object")
        return result
