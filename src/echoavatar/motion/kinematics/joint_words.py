"""What the name of a joint says: a side and a part of the body, in the words of many programs.

Names are read, not listed: namespaces, prefixes, case, separators and digits differ from program to program, but the
words for a thigh (`words.toml`) are few. `LeftUpLeg`, `mixamorig1:LeftUpLeg`, `J_Bip_L_UpperLeg`, `thigh.L`, `lfemur`
and `左足` all mean a left thigh.
"""

import re
import tomllib
import unicodedata
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

TABLES = tomllib.loads(Path(__file__).parents[1].joinpath("words.toml").read_text("utf-8"))
DIGITS = ("thumb", "index", "middle", "ring", "little")
CACHED = 4096  # names and words that are remembered
LONGEST_NAME = 256  # letters of a name that are read
LABEL_PARTS = 5  # an unknown word that stands beside so many parts of the body labels the rig, as `Bip01` does
LABEL_SHARE = 0.8  # any word that stands beside more of a rig's parts is a label, too
START_WORDS, END_WORDS = 5, 2  # the most words of a label in front of all names, and behind them
START_SHARE = 0.65  # a word with which more of all names begin or end is a label; fingers are fewer
_PARTS = TABLES["joints"]
_KINDS = [(f"side {side}", words) for kind in ("sides", "joint_sides") for side, words in TABLES[kind].items()]
_KINDS += [*_PARTS.items(), *TABLES["no_joints"].items()]
_WORDS = {word: kind for kind, words in _KINDS for word in words.split()}
_LONGEST = max(map(len, _WORDS))
_START, _END = re.compile(r"^[^\W_]+[\W_]+(?=\w)"), re.compile(r"(?<=[^\W_])[\W_]+[^\W_]+[\W_]*$")
_LABELS = (*START_WORDS * (_START,), *END_WORDS * (_END,))


class Said(NamedTuple):
    """What a name says."""

    side: str  # "left", "right", "" for neither
    part: str  # a key of the table of parts, "" for none
    number: int  # that follows the word for a finger; -1 for none
    is_metacarpal: bool
    helpers: tuple[str, ...]  # words for joints that are no bones of a body: twist, IK, end, hair and the like
    strangers: tuple[str, ...]  # unknown words
    plain: tuple[str, ...]  # all its words and digits except the side

    @property
    def is_helper(self) -> bool:
        """Whether the joint is no bone of a body."""
        return bool(self.helpers)


def read_names(names: Sequence[str]) -> list[Said]:
    """What each name of a rig says, without the words that label the whole rig."""
    said = [read_name(name) for name in _without_label(names)]
    parts = [one for one in said if one.part]
    beside: dict[str, list[str]] = {}
    for one in parts:
        for word in {*one.strangers, *one.helpers}:
            beside.setdefault(word, []).append(one.part)
    labels = {word for word, near in beside.items() if word not in _WORDS and len(set(near)) >= LABEL_PARTS}
    labels |= {word for word, near in beside.items() if len(near) > LABEL_SHARE * len(parts)}  # such as `ctrl`
    left = [[tuple(w for w in words if w not in labels) for words in (one.helpers, one.strangers)] for one in said]
    return [one._replace(helpers=h, strangers=s) for one, (h, s) in zip(said, left, strict=True)]


def _without_label(names: Sequence[str]) -> Sequence[str]:
    """The names without the words with which nearly all begin or end, whatever these mean: `HeadGirl_Hips`."""
    for pattern in _LABELS:
        labels = Counter(found[0] for name in names if (found := pattern.search(name)))
        label, count = max(labels.items(), key=lambda found: found[1], default=("", 0))
        plain = [name.removeprefix(label) if pattern is _START else name.removesuffix(label) for name in names]
        beside = {
            word for name, left in zip(names, plain, strict=True) if name != left for word in read_name(left).plain
        }
        is_whole = {"head", "foot"} <= {_WORDS.get(word, "").replace("ankle", "foot") for word in beside}
        said = read_name(label)
        is_label = label and not said.is_helper and not (said.side and pattern is _END)
        if is_label and (is_whole or count > START_SHARE * len(names)):
            names = plain
    return names


@lru_cache(maxsize=CACHED)
def read_name(name: str) -> Said:
    """What a name says by itself."""
    text = unicodedata.normalize("NFKC", re.split("[:|]", name)[-1][:LONGEST_NAME])
    words = [word for chunk in re.findall(r"[^\W\d_]+|\d+", text) for word in _words(chunk)]
    kinds = [_WORDS.get(word, "digits" if word.isdecimal() else "stranger") for word in words]
    sides = {kind[5:] for kind in kinds if kind.startswith("side")}
    body = [(word, kind) for word, kind in zip(words, kinds, strict=True) if not kind.startswith("side")]
    parts = _merged(body)
    last = max((at for at, (_, kind) in enumerate(body) if kind in (*DIGITS, "finger")), default=len(body))
    following = body[last + 1 : last + 2]
    number = int(following[0][0]) if following and following[0][1] == "digits" else -1
    return Said(
        side=sides.pop() if len(sides) == 1 else "",
        part=_part(parts),
        number=min(number, 99),
        is_metacarpal="metacarpal" in parts,
        helpers=tuple(word for word, kind in body if kind == "helper"),
        strangers=tuple(word for word, kind in body if kind == "stranger"),
        plain=tuple(word for word, _ in body),
    )


def _words(chunk: str) -> list[str]:
    """The words that a run of letters is made of: `luparm` of known words, `BipThigh` by its capitals."""
    if (whole := _split(chunk.lower())) is not None:
        return list(whole)
    pieces = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^A-Za-z]+", chunk)
    return [word for piece in pieces for word in _split(piece.lower()) or _labelled(piece.lower())]


@lru_cache(maxsize=CACHED)
def _labelled(text: str) -> tuple[str, ...]:
    """The words of a run of small letters that may begin with a label, as `mixamorighips` does."""
    for start in range(1, len(text)):
        words = _split(text[start:]) or ()
        if any(_WORDS.get(word) in _PARTS for word in words):
            return (text[:start], *words)
    return (text,)


@lru_cache(maxsize=CACHED)
def _split(text: str, is_first: bool = True) -> tuple[str, ...] | None:
    """The known words that make up the text, longest first; words of one or two letters count only at its ends."""
    if not text or text.isdecimal():
        return (text,) if text else ()
    for end in range(min(len(text), _LONGEST), 0, -1):
        word = text[:end]
        is_letter = word.isascii() and end <= 2
        if word in _WORDS and (not is_letter or is_first or end == len(text)):
            rest = _split(text[end:], False)
            if rest is not None and (not is_letter or not rest or _WORDS[rest[0]] in _PARTS):
                return (word, *rest)
    return None


def _merged(body: Sequence[tuple[str, str]]) -> list[str]:
    """The parts in order, where `upper arm` and `arm upper` are one."""
    found: list[str] = []
    at = 0
    while at < len(body):
        pair = [word for word, _ in body[at : at + 2]]
        both = next((_WORDS[word] for word in ("".join(pair), "".join(pair[::-1])) if word in _WORDS), "")
        if len(pair) == 2 and both in _PARTS:
            found.append(both)
            at += 2
            continue
        if body[at][1] in _PARTS:
            found.append(body[at][1])
        at += 1
    return found


def _part(parts: list[str]) -> str:
    """The one part that several words of a name mean: the thumb of `hand thumb`, the knee of `leg knee`."""
    if "foot" in parts and set(DIGITS) & set(parts):
        return "toe"
    for part in ("toe", "trunk", "neck", *DIGITS, "finger", "eye", "jaw"):
        if part in parts:
            return part
    special = [part for part in parts if part not in ("arm", "leg", "metacarpal")] or parts
    return special[-1] if special else ""
