"""What is said in the RL corpus: a few conversations of our own, any number made up by rule, and the user's scripts.

The paper had an hour of dialogue written by a language model (RL Alignment Corpus). A file of scripts is plain text:
scripts are parted by blank lines, each line is a turn, `A: ` or another name before it says whose (else two speakers
alternate), lines that begin with # are passed over.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import EchoAvatarError
from ..rehearsal.script import Sentence, parse_words, write_monologue

OWN = "own conversations"
RULE = "made up by rule"
_NAMED = re.compile(r"^([^\W\d_][\w .'-]{0,23}):\s+(?=\S)")
_TEST_EVERY = 10


@dataclass(frozen=True)
class Turn:
    """What one speaker says at a time; `speaker` counts from 0 in the order of first appearance."""

    speaker: int
    text: str
    sentences: tuple[Sentence, ...]  # for the local engines; empty where they cannot say it


@dataclass(frozen=True)
class Script:
    """A conversation."""

    name: str
    turns: tuple[Turn, ...]
    source: str
    split: Literal["train", "test"]


def conversations(seed: int, file: Path | None = None) -> Iterator[Script]:
    """Scripts without end: those of the file, our own, then ones made up; each depends on the seed and its number.

    Raises:
        EchoAvatarError: the file cannot be read, or holds no script.
    """
    written = [(f"file-{k:04d}", lines, file.name) for k, lines in enumerate(_blocks(file))] if file else []
    written += [(f"own-{k:04d}", block.splitlines(), OWN) for k, block in enumerate(_own())]
    for number, (name, lines, source) in enumerate(written):
        yield Script(name, _turns(lines), source, _split(number))
    number = 0
    while True:
        yield _made_up(seed, number)
        number += 1


def _split(number: int) -> Literal["train", "test"]:
    return "test" if number % _TEST_EVERY == _TEST_EVERY - 1 else "train"


def _made_up(seed: int, number: int) -> Script:
    """Two to six turns of one to four sentences of the rehearsal grammar."""
    rng, split = np.random.default_rng([seed, 0x5C, number]), _split(number)
    turns = []
    for speaker in range(int(rng.integers(2, 7))):
        said = write_monologue(rng, int(rng.integers(1, 5)), split)
        turns.append(Turn(speaker % 2, " ".join(sentence.text for sentence in said), said))
    return Script(f"rule-{seed}-{number:04d}", tuple(turns), RULE, split)


def _blocks(file: Path) -> list[list[str]]:
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise EchoAvatarError(
            f"scripts {file} cannot be read as UTF-8 text ({error}); check the file"
        ) from error
    kept = "\n".join(line.strip() for line in text.splitlines() if not line.lstrip().startswith("#"))
    blocks = [block.splitlines() for block in re.split(r"\n{2,}", kept) if block.strip()]
    blocks = [[line for line in block if line] for block in blocks]
    if not blocks:
        raise EchoAvatarError(
            f"scripts {file} holds no text; write a turn a line, a blank line between scripts"
        )
    return blocks


def _turns(lines: list[str]) -> tuple[Turn, ...]:
    speakers: dict[str, int] = {}
    turns: list[Turn] = []
    for line in lines:
        name = _NAMED.match(line)
        if name:
            speaker, text = speakers.setdefault(name[1], len(speakers)), line[name.end() :]
        else:
            speaker, text = len(turns) % 2, line
        turns.append(Turn(speaker, text, _sentences(text)))
    return tuple(turns)


def _sentences(text: str) -> tuple[Sentence, ...]:
    """Plain words and , . ? for engines that know no other signs."""
    plain = re.sub(r"[;:]", ",", text.replace("’", "'"))
    plain = re.sub(r"[^A-Za-z0-9',.?! ]", " ", plain)
    found = []
    for part in re.split(r"(?<=[.?!])\s+", plain):
        words = parse_words(" ".join(piece for piece in part.split() if re.search(r"[A-Za-z0-9]", piece)))
        if words:
            found.append(Sentence(words, ""))
    return tuple(found)


def _own() -> list[str]:
    return [block.strip() for block in _CONVERSATIONS.strip().split("\n\n")]


_CONVERSATIONS = """
A: There you are! I have been waiting for almost an hour. Did the train break down again?
B: Not the train, no. The whole bridge was closed. Nobody told us why, and then, all of a sudden, it was open again.
A: That is the third time this month. You should really start to ride your bicycle.
B: In this weather? No, thank you. I would rather be late and dry.

A: So, how did the interview go? Tell me everything, from the beginning.
B: Well, the first ten minutes were terrible. I could not even remember the name of my last company.
A: Oh no. What did you do?
B: I laughed, and I said so. And then they laughed, too, and after that it was just three people talking.
A: You see? I told you. They do not want a machine, they want someone who can think on their feet.

A: Could you show me how this thing works? I press the big button, and nothing happens at all.
B: First you have to fill the water up to this line here. Not more, or it runs over. Then you close the lid, like so.
A: And now the button?
B: Now the button. Wait for the click. There, did you hear it?
A: Yes! Six months I have owned it, and I never knew about the lid.

A: I think we should sell the car. We use it twice a month, and it costs us more than the rent of a small room.
B: And how do we get to your mother? It takes two hours by bus, and the last one leaves at six.
A: We could borrow one. Or we could go by train and stay the night. She would love that.
B: She would. I am not so sure about me.

A: Welcome, everybody, and thank you for coming. Today I want to talk about one thing only, and that is sleep.
A: We spend a third of our lives asleep. A third! And yet most of us know more about our phones than about our nights.
A: So let us begin with a simple question. When did you last wake up without an alarm, and feel rested?

A: Listen, this is the part I love. Wait. Wait for it. Now! Do you hear the drums drop out, and only the voice is left?
B: It is lovely. It reminds me of that small place by the harbor, where we danced until they threw us out.
A: They did not throw us out. They asked us, very politely, to go home.
B: At four in the morning. With a broom.

A: No, no, no. You cannot put the sofa there. Nobody will be able to open the window.
B: Then where? On this wall it is too long, and on that wall there is the heater.
A: What if we turn it around? Like this, with its back to the room.
B: Hm. You know what, that is not bad. It makes the room look bigger.

A: Doctor, it hurts here, when I lift my arm, and a little bit here, when I laugh.
B: Let me see. Does it hurt when I press? And here? On a scale from one to ten, how bad is it?
A: Four. No, five. At night it is more like seven.
B: I do not think anything is broken. Rest it for a week, nothing heavy, and come back if it gets worse.

A: Once upon a time there was a fox who was afraid of the dark.
A: Every evening, when the sun went down, he ran home as fast as he could and hid under his bed.
A: But one night the moon was so big, and so round, and so bright, that he forgot to be afraid.
A: And do you know what he saw? The whole forest was awake.

A: Can we go over the numbers once more? We sold two hundred in spring, and almost three times as many in summer.
B: Right, but look at the costs. They went up even faster. We earn less with every box that leaves the house.
A: So either we raise the price, or we find someone who packs them for less.
B: Or we make fewer kinds. Honestly, who needs eleven sorts of tea?
A: My aunt. But I take your point.
"""
