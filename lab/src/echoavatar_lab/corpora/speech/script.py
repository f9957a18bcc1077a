"""Scripts from a recursive template grammar with focus, pauses and meanings, so that no third-party text is needed.

Markup of a template: `{slot}` is expanded, `*word` is the focus, `word^tag` carries a meaning, `[p]` is a pause.
Training and test scripts share no sentence template and no pair of neighbouring slot words. Not in the paper.
"""

import re
from dataclasses import dataclass, replace
from functools import cache
from zlib import crc32

import numpy as np

from .vocabulary import PHRASES, SENTENCES, WORDS

_HELD_OUT_IN_100 = 12
_TEST_EVERY = 6  # every sixth template of a shape belongs to the test split


@dataclass(frozen=True)
class Word:
    """A written word; `pause` asks for a gap after it, `mark` is the punctuation that follows ("" , . ?)."""

    text: str
    is_focus: bool = False
    meaning: str = ""
    mark: str = ""
    pause: bool = False


@dataclass(frozen=True)
class Sentence:
    """Words of one sentence and the template they came from."""

    words: tuple[Word, ...]
    template: str

    @property
    def text(self) -> str:
        """Plain text with punctuation."""
        return " ".join(word.text + word.mark for word in self.words)


def write_sentence(rng: np.random.Generator, split: str = "train") -> Sentence:
    """Draw one sentence of a split ("train" or "test")."""
    while True:
        shapes = templates(split)
        choices = shapes[rng.integers(len(shapes))]
        template = choices[rng.integers(len(choices))]
        fills: list[str] = []
        text = _expand(template, rng, fills)
        held_out = [_is_held_out(a, b) for a, b in zip(fills, fills[1:], strict=False)]
        if any(held_out) if split == "test" and held_out else not any(held_out):
            return Sentence(parse_words(text), template)


def write_monologue(rng: np.random.Generator, sentences: int, split: str = "train") -> tuple[Sentence, ...]:
    """Several sentences of one speaker; no two in a row share a template."""
    out: list[Sentence] = []
    while len(out) < sentences:
        sentence = write_sentence(rng, split)
        if not out or sentence.template != out[-1].template:
            out.append(sentence)
    return tuple(out)


@cache
def templates(split: str) -> tuple[tuple[str, ...], ...]:
    """The sentence templates of a split, grouped by their shape in `SENTENCES`."""
    shapes = [
        tuple(t for i, t in enumerate(every) if ((i + rank) % _TEST_EVERY == 0) == (split == "test"))
        for rank, every in enumerate(SENTENCES.values())
    ]
    return tuple(shape for shape in shapes if shape)


def _expand(template: str, rng: np.random.Generator, fills: list[str]) -> str:
    """Replace slots from left to right and append the chosen words to `fills`."""

    def fill(match: re.Match[str]) -> str:
        slot = match.group(1)
        if slot in WORDS:
            word = WORDS[slot][rng.integers(len(WORDS[slot]))]
            fills.append(word)
            return word
        choices = PHRASES[slot]
        return _expand(choices[rng.integers(len(choices))], rng, fills)

    return re.sub(r"\{(\w+)\}", fill, template)


def _is_held_out(first: str, second: str) -> bool:
    return crc32(f"{first}|{second}".encode()) % 100 < _HELD_OUT_IN_100


def parse_words(text: str) -> tuple[Word, ...]:
    """Parse marked text: `*focus`, `word^meaning`, `[p]` for a pause, punctuation."""
    words: list[Word] = []
    for piece in text.split():
        if piece == "[p]":
            if words:
                words[-1] = replace(words[-1], mark=words[-1].mark or ",", pause=True)
            continue
        marks = re.sub(r"[^,.?!]", "", piece)
        body, _, meaning = re.sub(r"[,.?!]", "", piece).partition("^")
        words.append(Word(body.lstrip("*"), body.startswith("*"), meaning, marks[:1].replace("!", ".")))
    return tuple(words)
