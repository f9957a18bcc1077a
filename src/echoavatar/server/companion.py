"""The companion behind the live page's chat box, which chooses the avatar's words and actions, and the box's routes.

`ChatModel` asks a language model at any OpenAI-compatible endpoint (Chat Completions with tools, and transcription),
set by environment variables. It asks over HTTP, from a thread. The key is sent in one header to that endpoint and
appears nowhere else. Without a model, `Scripted` matches words to lines that show speech, gestures, music and
interruption. If asked, it says that it is a script. Its choice among several lines depends on the length of the
conversation only, so the same conversation always goes the same way. Neither keeps the conversation; the caller passes
in the turns so far.
"""

import asyncio
import json
import os
import re
import secrets
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from echoavatar import outgoing
from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object
from echoavatar.limits import read_text
from echoavatar.wire.guard import check_origin

from .session_manager import SessionManager
from .tool_routes import answering, asked_session, read_body, read_json

Do = Callable[[str, dict[str, Any]], Awaitable[dict[str, Any]]]
MAX_HISTORY_TURNS = 24  # turns, of both sides together
TIMEOUT_S = 60.0
MAX_TOOL_ROUNDS = 3  # rounds of tool calls before the model must answer in words
MAX_TOKENS = 300
MOST_LETTERS = 2_000
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
ACTION_LINES = (
    "Watch closely, this one took me a whole afternoon.",
    "For you, Producer, with extra elbow.",
    "That? In my sleep. But look how I do it awake.",
)
# What it can do, for what it does not understand.
FALLBACKS = (
    ("I did not understand that. I can wave, nod, bow, point, clap or think; say music, and I dance.", "thinking"),
    ("I am a script with few words. Ask me to wave, to bow or to look around; say music, or say stop.", "give_up"),
)
SYNONYMS = {
    "shrug": "give_up",
    "think": "thinking",
    "nod": "agree",
    "applaud": "clap",
    "cheer": "happy",
    "cry": "sad",
    "look around": "look_around",
    "hands up": "raise_both_hands",
    "relax": "neutral",
}


class ChatTurn(NamedTuple):
    """A turn of the conversation."""

    role: str  # user or assistant
    text: str


class ToolAccess(NamedTuple):
    """The avatar's tools: their declarations for Chat Completions, and a function that carries out a call."""

    tools: Sequence[Mapping[str, Any]]
    do: Do

    def choices(self, name: str, argument: str) -> list[str]:
        """The values that an argument of a tool may take; empty if the tool does not list any."""
        arguments = {tool["function"]["name"]: tool["function"]["parameters"]["properties"] for tool in self.tools}
        return list(arguments.get(name, {}).get(argument, {}).get("enum", ()))


class ChatModel:
    """A model at `url`, such as http://127.0.0.1:11434/v1."""

    def __init__(self, url: str, *, model: str, key: str = "", transcriber: str = "", persona: str = PERSONA) -> None:
        """`transcriber` names a model for `/audio/transcriptions` at the same address; empty: no transcription.

        Raises EchoAvatarError if the address is not valid, or no model is named.
        """
        if not url.startswith(("http://", "https://")):
            raise EchoAvatarError(
                f"ECHOAVATAR_CHAT_URL {outgoing.redacted(url)!r} is not an address; give one such as http://127.0.0.1:11434/v1"
            )
        if not model:
            raise EchoAvatarError("ECHOAVATAR_CHAT_MODEL is not set; name a model of ECHOAVATAR_CHAT_URL")
        self.name, self.hears = model, bool(transcriber)  # whether `transcribe` works
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
            if turn < MAX_TOOL_ROUNDS and doing.tools:
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
        answer = await asyncio.to_thread(self._post, "/chat/completions", request)
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


class Cue(NamedTuple):
    """A pattern, the lines to say if it matches, and the tool and action that go with them."""

    words: str  # regular expression
    lines: tuple[str, ...]
    tool: str = ""
    action: str = ""


CUES = (
    Cue(
        r"\b(stop|enough|quiet|silence)\b",
        ("And cut! Every show needs an ending.", "Fine, fine. Silence is also music."),
        "stop_music",
    ),
    Cue(
        r"\b(music|song|dance|dancing|track|beat|waltz|salsa|swing|house)\b",
        (
            "Finally, the good part! Watch my feet, Producer, they have been waiting for this.",
            "You said the magic word. Lights, please, and do not blink.",
        ),
        "play_music",
    ),
    Cue(
        r"\b(interrupt|barge)",
        (
            "Oh, I could talk about myself for hours. It all began on a stage much like this one, with one lamp, no "
            "audience, and a step to the left that nobody had asked for. Then came the second step, and the third, and "
            "you may stop me at any time with the Interrupt button, or just by typing, and my body will know exactly "
            "how far I got, which is further than most people let me.",
        ),
    ),
    Cue(
        r"\b(who|what) are you\b|\byour name\b|\breal\b|\brobot\b|\bai\b",
        (
            "I am the star of this stage! Between us: right now a small script writes my lines. My moves are made "
            "from the sound of my voice, though, as I speak.",
        ),
        action="happy",
    ),
    Cue(
        r"\bhelp\b|\bcan you do\b|\bwhat can\b|\bshow me\b|\bhow does\b",
        (
            "I talk, I gesture, I dance. Ask me to wave, to bow, to point left, or to think. Say music, and I dance. "
            "And do interrupt me, I am used to applause in the wrong places.",
        ),
        action="raise_both_hands",
    ),
    Cue(
        r"\b(hello|hi|hey|good (morning|evening|day))\b",
        (
            "Hello, Producer! You are just in time for the rehearsal. Shall I show you something?",
            "There you are! I have been practising this wave all day.",
        ),
        action="wave",
    ),
    Cue(
        r"\b(bye|goodbye|good night|see you)\b", ("Leaving already? Then you get my best bow, for free.",), action="bow"
    ),
    Cue(
        r"\b(thank|thanks|great|wonderful|bravo|beautiful|love)\b",
        ("I know! But say it again, a little louder.", "You have excellent taste, Producer."),
        action="bow",
    ),
    Cue(r"\bno\b|\bwrong\b|\bbad\b", ("No? I disagree with my whole upper body.",), action="disagree"),
    Cue(r"\byes\b|\bright\b|\bok(ay)?\b", ("Exactly what I thought. Great minds, great posture.",), action="agree"),
)


class Scripted:
    """Answers from a script, without a model."""

    name = "script"
    hears = False

    async def reply(self, said: str, history: Sequence[ChatTurn], doing: ToolAccess) -> str:
        """A line in answer to `said`; starts the action or music that goes with it."""
        text, turn = said.lower(), len(history)
        named = _find_action(text, doing.choices("send_action", "action"))
        if named:
            await doing.do("send_action", {"action": named})
            return ACTION_LINES[turn // 2 % len(ACTION_LINES)]
        for cue in CUES:
            if re.search(cue.words, text):
                if cue.tool == "play_music":
                    await doing.do(cue.tool, _title_argument(text, doing.choices("play_music", "title")))
                elif cue.tool:
                    await doing.do(cue.tool, {})
                if cue.action:
                    await doing.do("send_action", {"action": cue.action})
                return cue.lines[turn // 2 % len(cue.lines)]
        line, action = FALLBACKS[turn // 2 % len(FALLBACKS)]
        await doing.do("send_action", {"action": action})
        return line

    async def transcribe(self, wav: bytes) -> str:
        """Raises EchoAvatarError: the script cannot transcribe speech."""
        del wav
        raise EchoAvatarError(
            "the script does not understand speech; type, or set ECHOAVATAR_CHAT_URL and ECHOAVATAR_CHAT_EARS"
        )


Companion = ChatModel | Scripted


def _find_action(text: str, actions: Sequence[str]) -> str:
    """The action that the text names, by its own name or by a synonym."""
    own = [(rf"\b{re.escape(name.replace('_', ' '))}\b", name) for name in actions]
    others = [(rf"\b{words}", name) for words, name in SYNONYMS.items() if name in actions]
    return next((name for words, name in own + others if re.search(words, text)), "")


def _title_argument(text: str, titles: Sequence[str]) -> dict[str, str]:
    """The track whose title shares most words with the text; without a match, the server chooses."""
    said = set(re.findall(r"\w+", text))
    scores = {title: len(said & set(re.findall(r"\w+", title.lower()))) for title in titles}
    best = max(scores, key=scores.__getitem__, default="")
    return {"title": best} if best and scores[best] else {}


def from_environment(environment: Mapping[str, str] = os.environ) -> Companion:
    """A language model if `ECHOAVATAR_CHAT_URL` is set, else the script.

    `ECHOAVATAR_CHAT_MODEL`, `ECHOAVATAR_CHAT_KEY`, `ECHOAVATAR_CHAT_EARS` (a model that transcribes speech) and
    `ECHOAVATAR_PERSONA` (a text file) configure the model. Raises EchoAvatarError if the address is not valid, the
    model is not named, or the file cannot be read.
    """
    url = environment.get("ECHOAVATAR_CHAT_URL", "")
    if not url:
        return Scripted()
    path = environment.get("ECHOAVATAR_PERSONA", "")
    persona = read_text(Path(path), "give a text file as ECHOAVATAR_PERSONA") if path else PERSONA
    return ChatModel(
        url,
        model=environment.get("ECHOAVATAR_CHAT_MODEL", ""),
        key=environment.get("ECHOAVATAR_CHAT_KEY", ""),
        transcriber=environment.get("ECHOAVATAR_CHAT_EARS", ""),
        persona=persona,
    )


def chat_routes(manager: SessionManager) -> list[BaseRoute]:
    """The companion's name (GET /v1/chat), its reply to `{"session", "text", "history"}` (POST), and transcription."""
    companion = lru_cache(maxsize=1)(from_environment)

    async def name(_: Request) -> dict[str, Any]:
        return {"name": companion().name, "hears": companion().hears}

    async def talk(request: Request) -> dict[str, Any]:
        message = await read_json(request, manager.settings.origins, most=1 << 16)
        text = message.get("text")
        if not isinstance(text, str) or not text.strip() or len(text) > MOST_LETTERS:
            raise EchoAvatarError(f'send {{"text": "..."}} of at most {MOST_LETTERS} letters')
        session = asked_session(manager, request, message)
        did: list[dict[str, Any]] = []

        async def do(name: str, arguments: dict[str, Any]) -> dict[str, Any]:
            result = await manager.toolbox.call(session, name, arguments, manager.load_track)
            did.append({"name": name, "arguments": arguments, "status": result.get("status", "done")})
            return result

        doing = ToolAccess(manager.toolbox.schemas("openai-chat"), do)
        return {"say": await companion().reply(text, _history(message.get("history")), doing), "did": did}

    async def hear(request: Request) -> dict[str, Any]:
        check_origin(request.headers, manager.settings.origins)
        if request.headers.get("content-type") != "audio/wav":  # a form on another page cannot say so
            raise EchoAvatarError("send audio/wav")
        return {"text": await companion().transcribe(await read_body(request, MOST_SOUND))}

    return [
        Route("/v1/chat", answering(manager, name, failure=503)),
        Route("/v1/chat", answering(manager, talk), methods=["POST"]),
        Route("/v1/chat/ears", answering(manager, hear), methods=["POST"]),
    ]


def _history(given: Any) -> list[ChatTurn]:
    """The turns of the conversation so far; entries of the wrong shape are left out."""
    rows = given[-MAX_HISTORY_TURNS:] if isinstance(given, list) else []
    return [
        ChatTurn(row["role"], row["text"][:MOST_LETTERS])
        for row in rows
        if isinstance(row, dict) and row.get("role") in ("user", "assistant") and isinstance(row.get("text"), str)
    ]
