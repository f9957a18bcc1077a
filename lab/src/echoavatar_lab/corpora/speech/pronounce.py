"""Spelling to sound for the rehearsal scripts: a few spelling rules and a list of exceptions.

Good enough for an audible syllable structure, but no dictionary of English. Phone names are ARPABET in lower case.
"""

import re
from functools import cache

VOWELS = frozenset(["aa", "ae", "ah", "ao", "aw", "ax", "ay", "eh", "er", "ey", "ih", "iy", "ow", "oy", "uh", "uw"])

# Tried in this order at each letter, so longer spellings come first; "" is silent.
_RULES: tuple[tuple[str, str], ...] = (
    ("tion", "sh ax n"), ("ould", "uh d"), ("ough", "ao"), ("augh", "ao"), ("eigh", "ey"), ("ture", "ch er"),
    ("igh", "ay"), ("ing", "ih ng"), ("tch", "ch"), ("dge", "jh"), ("ear", "ih r"), ("air", "eh r"),
    ("oor", "ao r"), ("our", "aw er"), ("ous", "ax s"), ("que", "k"), ("all", "ao l"), ("alk", "ao k"),
    ("ee", "iy"), ("ea", "iy"), ("oo", "uw"), ("ou", "aw"), ("ow", "ow"), ("oa", "ow"), ("oi", "oy"), ("oy", "oy"),
    ("ai", "ey"), ("ay", "ey"), ("au", "ao"), ("aw", "ao"), ("ew", "uw"), ("ie", "iy"), ("ey", "iy"), ("ui", "uw"),
    ("er", "er"), ("ir", "er"), ("ur", "er"), ("ar", "aa r"), ("or", "ao r"), ("ph", "f"), ("sh", "sh"),
    ("ch", "ch"), ("th", "th"), ("wh", "w"), ("ck", "k"), ("kn", "n"), ("wr", "r"), ("gh", ""), ("ng", "ng"),
    ("qu", "k w"), ("ss", "s"), ("ll", "l"), ("tt", "t"), ("pp", "p"), ("nn", "n"), ("mm", "m"), ("rr", "r"),
    ("dd", "d"), ("bb", "b"), ("gg", "g"), ("ff", "f"), ("zz", "z"), ("cc", "k"), ("ce", "s eh"), ("ci", "s ih"),
    ("cy", "s iy"), ("a", "ae"), ("e", "eh"), ("i", "ih"), ("o", "aa"), ("u", "ah"), ("y", "iy"), ("b", "b"),
    ("c", "k"), ("d", "d"), ("f", "f"), ("g", "g"), ("h", "hh"), ("j", "jh"), ("k", "k"), ("l", "l"), ("m", "m"),
    ("n", "n"), ("p", "p"), ("q", "k"), ("r", "r"), ("s", "s"), ("t", "t"), ("v", "v"), ("w", "w"), ("x", "k s"),
    ("z", "z"),
)  # fmt: skip
_LONG = {"a": "ey", "e": "iy", "i": "ay", "o": "ow", "u": "uw", "y": "ay"}
_SOFT = {"c": "s", "g": "jh", "s": "z"}
_EXCEPTIONS: dict[str, str] = {
    "i": "ay", "a": "ax", "the": "dh ax", "to": "t uw", "do": "d uw", "you": "y uw", "your": "y ao r",
    "yours": "y ao r z", "my": "m ay", "by": "b ay", "me": "m iy", "we": "w iy", "he": "hh iy", "she": "sh iy",
    "they": "dh ey", "was": "w ah z", "were": "w er", "is": "ih z", "are": "aa r", "am": "ae m", "of": "ah v",
    "one": "w ah n", "two": "t uw", "eight": "ey t", "who": "hh uw", "what": "w ah t", "where": "w eh r",
    "why": "w ay", "there": "dh eh r", "this": "dh ih s", "that": "dh ae t", "then": "dh eh n", "than": "dh ae n",
    "no": "n ow", "so": "s ow", "go": "g ow", "oh": "ow", "people": "p iy p ax l", "said": "s eh d",
    "some": "s ah m", "come": "k ah m", "because": "b ih k ao z", "enormous": "ih n ao r m ax s",
    "giant": "jh ay ax n t", "idea": "ay d iy ax", "ideas": "ay d iy ax z", "ocean": "ow sh ax n",
    "machine": "m ax sh iy n", "engine": "eh n jh ih n", "answer": "ae n s er", "island": "ay l ax n d",
    "friends": "f r eh n d z", "minutes": "m ih n ax t s", "mountain": "m aw n t ax n", "village": "v ih l ih jh",
    "camera": "k ae m r ax", "hour": "aw er", "hours": "aw er z", "music": "m y uw z ih k", "new": "n uw",
    "telephone": "t eh l ax f ow n", "elephant": "eh l ax f ax n t", "hundred": "hh ah n d r ax d",
    "company": "k ah m p ax n iy", "monkey": "m ah ng k iy", "nothing": "n ah th ih ng", "really": "r iy l iy",
    "question": "k w eh s ch ax n", "everybody": "eh v r iy b aa d iy", "everyone": "eh v r iy w ah n",
    "somebody": "s ah m b aa d iy", "nobody": "n ow b aa d iy", "second": "s eh k ax n d", "only": "ow n l iy",
    "women": "w ih m ax n", "their": "dh eh r", "put": "p uh t", "push": "p uh sh", "pull": "p uh l",
    "full": "f uh l", "book": "b uh k", "books": "b uh k s", "look": "l uh k", "looks": "l uh k s", "good": "g uh d",
    "know": "n ow", "down": "d aw n", "how": "hh aw", "now": "n aw", "wow": "w aw", "town": "t aw n",
    "umbrella": "ah m b r eh l ax", "around": "ax r aw n d", "about": "ax b aw t", "again": "ax g eh n",
    "already": "ao l r eh d iy", "afraid": "ax f r ey d", "together": "t ax g eh dh er", "tomorrow": "t ax m aa r ow",
    "tonight": "t ax n ay t", "today": "t ax d ey", "before": "b ih f ao r", "behind": "b ih hh ay n d",
    "remembered": "r ih m eh m b er d", "remember": "r ih m eh m b er", "forgot": "f er g aa t",
    "forget": "f er g eh t", "returned": "r ih t er n d", "computer": "k ax m p y uw t er", "hello": "hh ax l ow",
    "excited": "ih k s ay t ax d", "surprised": "s er p r ay z d", "goodbye": "g uh d b ay", "until": "ax n t ih l",
    "potato": "p ax t ey t ow", "believe": "b ih l iy v", "suppose": "s ax p ow z", "eleven": "ih l eh v ax n",
    "change": "ch ey n jh", "strange": "s t r ey n jh", "huge": "hh y uw jh",
    "guitar": "g ih t aa r", "imagine": "ih m ae jh ih n", "repair": "r ih p eh r", "collect": "k ax l eh k t",
}  # fmt: skip
# Words stressed on their second syllable.
_LATE_TEXT = """
    enormous machine again already afraid together tomorrow tonight today before behind remember remembered forgot
    forget returned computer hello excited surprised goodbye until potato believe eleven idea ideas imagine repair
    collect about around umbrella because maria
"""
_LATE = frozenset(_LATE_TEXT.split())


@cache
def pronounce(word: str) -> tuple[str, ...]:
    """Phones of a word."""
    letters = re.sub(r"[^a-z]", "", word.lower())
    if letters in _EXCEPTIONS:
        return tuple(_EXCEPTIONS[letters].split())
    tail: list[str] = []
    if len(letters) > 4 and letters.endswith("ed"):
        tail = ["ax", "d"] if letters[-3] in "td" else ["t"] if letters[-3] in "pkfsx" else ["d"]
        letters = letters[:-2]
    phones = _by_rules(letters) + tail
    if not any(phone in VOWELS for phone in phones):
        phones.insert(min(1, len(phones)), "ax")
    return tuple(phones)


def _by_rules(letters: str) -> list[str]:
    phones: list[str] = []
    place = 0
    while place < len(letters):
        rest = letters[place:]
        if re.fullmatch(r"[aeiouy][^aeiouyw]e(s?)", rest):  # a silent e makes the vowel long
            plural = ["z"] if rest.endswith("s") else []
            middle = [_SOFT[rest[1]]] if rest[1] in _SOFT else _by_rules(rest[1])
            return phones + [_LONG[rest[0]], *middle, *plural]
        if rest == "le" and phones and phones[-1] not in VOWELS:
            return [*phones, "ax", "l"]
        if rest == "e" and phones and any(phone in VOWELS for phone in phones):
            return phones
        if rest == "y" and not any(phone in VOWELS for phone in phones):
            return [*phones, "ay"]
        if rest[0] == "y" and place == 0:
            phones.append("y")
            place += 1
            continue
        spelling, sound = next((s, p) for s, p in _RULES if rest.startswith(s))
        phones += sound.split()
        place += len(spelling)
    return phones


def syllabify(word: str) -> tuple[tuple[tuple[str, ...], bool], ...]:
    """Syllables of a word as (phones, is stressed); an inner syllable begins with at most one consonant."""
    phones = pronounce(word)
    nuclei = [i for i, phone in enumerate(phones) if phone in VOWELS]
    starts = [0] + [i - 1 if i - 1 > before else i for before, i in zip(nuclei, nuclei[1:], strict=False)]
    stressed = 1 if word.lower() in _LATE and len(nuclei) > 1 else 0
    ends = [*starts[1:], len(phones)]
    return tuple((phones[a:b], i == stressed) for i, (a, b) in enumerate(zip(starts, ends, strict=True)))
