"""A companion without a model. It matches words to lines that show speech, gestures, music and interruption.

Asked what it is, it says so. Which of several lines it takes depends on the length of the conversation only, so the
same conversation always goes the same way.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from echoavatar.errors import EchoAvatarError

from .talk import ChatTurn, ToolAccess


class Cue(NamedTuple):
    """A pattern to look for, what to say if it matches, and what to do."""

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
ACTION_LINES = (
    "Watch closely, this one took me a whole afternoon.",
    "For you, Producer, with extra elbow.",
    "That? In my sleep. But look how I do it awake.",
)
FALLBACKS = (
    ("Interesting! I have no line for that, only a very thoughtful pose.", "thinking"),
    ("That went over my head, and my head is quite high up. Ask me to dance instead?", "give_up"),
    ("Go on, I am all ears and fingers.", "agree"),
    ("A small script like me can only nod at that. The stage, however, is mine: try the word music.", "look_around"),
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


class Scripted:
    """The script."""

    name = "script"
    hears = False

    async def reply(self, said: str, history: Sequence[ChatTurn], doing: ToolAccess) -> str:
        """A line for what was said; starts the action or music that goes with it."""
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
        """Not supported: the script cannot transcribe speech."""
        del wav
        raise EchoAvatarError(
            "the script does not understand speech; type, or set ECHOAVATAR_CHAT_URL and ECHOAVATAR_CHAT_EARS"
        )


def _find_action(text: str, actions: Sequence[str]) -> str:
    """The action that the text names, by its own name or by a synonym."""
    for name in actions:
        if re.search(rf"\b{re.escape(name.replace('_', ' '))}\b", text):
            return name
    for words, name in SYNONYMS.items():
        if name in actions and re.search(rf"\b{words}", text):
            return name
    return ""


def _title_argument(text: str, titles: Sequence[str]) -> dict[str, str]:
    """The track whose title shares most words with the text; without a match, the server chooses."""
    said = set(re.findall(r"\w+", text))
    scores = {title: len(said & set(re.findall(r"\w+", title.lower()))) for title in titles}
    best = max(scores, key=scores.__getitem__, default="")
    return {"title": best} if best and scores[best] else {}
