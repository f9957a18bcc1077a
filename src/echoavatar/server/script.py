"""The companion's script: phrases, the words and actions that answer each, and an answer to anything else.

Its choice among several lines depends on the length of the conversation only, so the same conversation always goes the
same way. If asked, it says that it is a script.
"""

import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, NamedTuple

Do = Callable[[str, dict[str, Any]], Awaitable[dict[str, Any]]]
ACTION_LINES = (
    "Watch closely, this one took me a whole afternoon.",
    "For you, Producer, with extra elbow.",
    "That? In my sleep. But look how I do it awake.",
)
# The answers to what it does not understand.
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


_PLAY = ("", "play ", "play the ")


class ChatTurn(NamedTuple):
    """A turn of the conversation."""

    role: str  # user or assistant
    text: str


class ToolAccess(NamedTuple):
    """The avatar's tools: their declarations for Chat Completions, and a function that carries out a call."""

    tools: Sequence[Mapping[str, Any]]
    do: Do


class Cue(NamedTuple):
    """Phrases, the lines that answer them, and the tool and action that go with the lines."""

    phrases: tuple[str, ...]
    lines: tuple[str, ...]
    tool: str = ""
    action: str = ""


CUES = (
    Cue(
        ("stop", "stop the music", "enough", "quiet", "silence"),
        ("And cut! Every show needs an ending.", "Fine, fine. Silence is also music."),
        "stop_music",
    ),
    Cue(
        ("music", "play music", "song", "dance", "dancing", "track", "beat", "waltz", "salsa", "swing", "house"),
        (
            "Finally, the good part! Watch my feet, Producer, they have been waiting for this.",
            "You said the magic word. Lights, please, and do not blink.",
        ),
        "play_music",
    ),
    Cue(
        ("interrupt", "barge in"),
        (
            "Oh, I could talk about myself for hours. It all began on a stage much like this one, with one lamp, no "
            "audience, and a step to the left that nobody had asked for. Then came the second step, and the third, and "
            "you may stop me at any time with the Interrupt button, or just by typing, and my body will know exactly "
            "how far I got, which is further than most people let me.",
        ),
    ),
    Cue(
        ("who are you", "what are you", "your name", "real", "robot", "ai"),
        (
            "I am the star of this stage! Between us: right now a small script writes my lines. My moves are made "
            "from the sound of my voice, though, as I speak.",
        ),
        action="happy",
    ),
    Cue(
        ("help", "can you do", "what can you do", "what can", "show me", "how does"),
        (
            "I talk, I gesture, I dance. Ask me to wave, to bow, to point left, or to think. Say music, and I dance. "
            "And do interrupt me, I am used to applause in the wrong places.",
        ),
        action="raise_both_hands",
    ),
    Cue(
        ("hello", "hi", "hey", "good morning", "good evening", "good day"),
        (
            "Hello, Producer! You are just in time for the rehearsal. Shall I show you something?",
            "There you are! I have been practising this wave all day.",
        ),
        action="wave",
    ),
    Cue(
        ("bye", "goodbye", "good night", "see you"),
        ("Leaving already? Then you get my best bow, for free.",),
        action="bow",
    ),
    Cue(
        ("thank", "thank you", "thanks", "great", "wonderful", "bravo", "beautiful", "love"),
        ("I know! But say it again, a little louder.", "You have excellent taste, Producer."),
        action="bow",
    ),
    Cue(("no", "wrong", "bad"), ("No? I disagree with my whole upper body.",), action="disagree"),
    Cue(("yes", "right", "ok", "okay"), ("Exactly what I thought. Great minds, great posture.",), action="agree"),
)


class Scripted:
    """Answers from a script, without a model."""

    name = "script"
    hears = where = ""

    async def reply(self, said: str, history: Sequence[ChatTurn], doing: ToolAccess) -> str:
        """A line in answer to `said`; starts the action or music that goes with it."""
        text, turn = said.lower(), len(history)
        named = _find_action(text, choices(doing.tools, "send_action", "action"))
        if named:
            await doing.do("send_action", {"action": named})
            return ACTION_LINES[turn // 2 % len(ACTION_LINES)]
        for cue in CUES:
            if re.search(rf"\b({'|'.join(cue.phrases)})\b", text):
                if cue.tool == "play_music":
                    await doing.do(cue.tool, _title_argument(text, choices(doing.tools, "play_music", "title")))
                elif cue.tool:
                    await doing.do(cue.tool, {})
                if cue.action:
                    await doing.do("send_action", {"action": cue.action})
                return cue.lines[turn // 2 % len(cue.lines)]
        line, action = FALLBACKS[turn // 2 % len(FALLBACKS)]
        await doing.do("send_action", {"action": action})
        return line


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


def choices(tools: Sequence[Mapping[str, Any]], name: str, argument: str) -> list[str]:
    """The values that an argument of a tool may take; empty if the tool does not list any."""
    arguments = {tool["function"]["name"]: tool["function"]["parameters"]["properties"] for tool in tools}
    return list(arguments.get(name, {}).get(argument, {}).get("enum", ()))


def phrases(tools: Sequence[Mapping[str, Any]]) -> list[str]:
    """What the script answers to: names of actions, titles of tracks, and its cues."""
    actions = choices(tools, "send_action", "action")
    own = [name.replace("_", " ") for name in actions]
    own += [words for words, name in SYNONYMS.items() if name in actions]
    titles = [f"{play}{title.lower()}" for title in choices(tools, "play_music", "title") for play in _PLAY]
    return [*own, *titles, *(phrase for cue in CUES for phrase in cue.phrases)]
