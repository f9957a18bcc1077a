"""Gestures that words ask for: a hand to the chest at "me", an open arm at "there". Not in the paper.

The generator hears sound alone and knows no words. Where a voice tells its words and their times, some of them begin an
action of the library, so early that its stroke meets the word. `words.json` holds the words of each concept, and the
actions that show it. Which words get a gesture depends on the seed, the liveliness and earlier gestures.
"""

import logging
import math
import operator
import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_json, read_object_file
from echoavatar.limits import CONFIG_BYTES, decoded, read_bytes, readable
from echoavatar.timing import SAMPLE_RATE_HZ, ChunkSize

from .action_scheduler import ActionScheduler
from .audio_queue import AudioQueue
from .pipeline import ActionLibrary

TABLE = Path(__file__).with_name("words.json")
GAP_S = 4.0  # between the beginnings of two gestures: people make no more gestures with a meaning
AGAIN_S = 12.0  # between two gestures of one concept
PAST_S = 30.0  # how long words are kept after their time; sessions do not go back so far
WORDS, UTTERANCES = 20_000, 256  # most that may wait
LETTERS, LATEST_S = 100, 86_400.0  # most letters of a word, its latest time
AT_ONCE = 64  # most words that one chunk examines; people say ten in that time
PHRASE = 4  # words of the longest phrase in the table
_SLOWEST_S = 10.0  # mean length of words; if it is longer, the times are milliseconds
_LOG = logging.getLogger(__name__)
_start = operator.itemgetter(1)
_CLOCK = r"(?:(\d{1,3}):)?(\d\d):(\d\d[.,]\d{1,3})"
_CUE = re.compile(_CLOCK + " +--> +" + _CLOCK + r"[^\n]*\n((?:[^\n]+\n?)*)")
_TAG = re.compile("<[^<>]*>")
_TOKENS = re.compile(r"[\w']+|\?")


class Word(NamedTuple):
    """A word; times are seconds from the first sample of its utterance."""

    text: str
    start: float
    end: float | None = None


def read_words(path: Path) -> list[Word]:
    """Words of a file, in order: captions (.vtt, .srt), or JSON as many speech recognisers write it.

    In JSON, words or sentences are objects with `text` or `word`, and `start` and perhaps `end`, or `timestamp` with
    both; of several lists the longest counts, and of equals the last. The words of a sentence share its time by their
    letters. An empty list has no words. Raises EchoAvatarError if the file cannot be read, or holds something else.
    """
    with readable(path):
        data = read_bytes(path, CONFIG_BYTES)
    lists: dict[tuple[str, ...], list[Word]] = {}
    is_caption = path.suffix.lower() in (".vtt", ".srt")
    if is_caption:
        lists[()] = [_caption(cue) for cue in _CUE.finditer(decoded(data)[0].replace("\r", ""))]
    elif value := read_json(data, str(path)):
        for place, said in _said([value], ()):
            lists.setdefault(place, []).append(said)
    else:
        return []
    found = [word for said in max(reversed(lists.values()), key=len, default=[]) for word in _shared(said)]
    if not found:
        raise EchoAvatarError(f"{path} holds no words; give JSON, a list of {{text, start, end}}, or captions")
    lengths = [word.end - word.start for word in found if word.end is not None]
    if not is_caption and sum(lengths) > _SLOWEST_S * len(found):
        _LOG.warning("%s: its times are taken for milliseconds", path)
        found = [Word(text, at / 1000, None if end is None else end / 1000) for text, at, end in found]
    return sorted(found, key=_start)


def _said(value: Any, place: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Word]]:
    """Words and sentences in JSON, each with the keys on the way to it."""
    if isinstance(value, dict):
        text, times = value.get("text", value.get("word")), value.get("timestamp")
        start, end = times if isinstance(times, list) and len(times) == 2 else (value.get("start"), value.get("end"))
        if isinstance(text, str) and isinstance(start, int | float):
            yield place, Word(text, start, end if isinstance(end, int | float) else None)
    for key, inner in value.items() if isinstance(value, dict) else (("", one) for one in value):
        if isinstance(inner, dict | list):
            yield from _said(inner, (*place, key) if key else place)


def _shared(said: Word) -> Iterator[Word]:
    """The words of a sentence; each has a share of its time, by their letters."""
    words, at = said.text.split(), said.start
    per_letter = None if said.end is None else (said.end - said.start) / max(sum(map(len, words)), 1)
    for word in words:
        end = None if per_letter is None else at + per_letter * len(word)
        yield Word(word, at, end)
        at = at if end is None else end


class _Concept(NamedTuple):
    name: str
    chance: float  # of a gesture for each of its words
    leads: Mapping[str, int]  # chunks from the beginning of each action that shows it to its stroke


class WordGestures:
    """The words of one session, and the gestures that they ask for. The session holds its lock around every call."""

    def __init__(self, seed: int, actions: ActionScheduler, queue: AudioQueue, chunk: ChunkSize) -> None:
        self._seed, self._actions, self._queue, self._chunk = seed, actions, queue, chunk
        self._concepts = _concepts(actions.library)
        leads = [lead for concept in self._concepts.values() for lead in concept.leads.values()]
        self._ahead_s = (max(leads, default=0) + 1) * chunk.seconds  # how far ahead of a word its gesture may begin
        self._words: dict[int, list[Word]] = {}

    def add(self, rows: Iterable[Sequence[Any]], utterance: int | None = None) -> None:
        """Add words of an utterance, none of which begins before those that are there.

        Without an utterance, their times count from the next sample that is pushed. Raises EchoAvatarError if a word is
        too long, a time is wrong or out of order, or too many words wait.
        """
        words = _words_of(rows)
        if utterance is None:
            utterance, since = self._queue.newest, self._queue.pushed / SAMPLE_RATE_HZ
            words = [Word(text, since + at, None if end is None else since + end) for text, at, end in words]
        held = self._words.get(utterance, [])
        count, utterances = sum(map(len, self._words.values())) + len(words), len(self._words) + (not held)
        if count > WORDS or utterances > UTTERANCES:
            raise EchoAvatarError(
                f"{count:,} words of {utterances} utterances are more than the {WORDS:,} of {UTTERANCES} that may "
                "wait; send words with their sound"
            )
        latest = held[-1].start if held else 0.0
        for word in words:
            _check(word, latest)
            latest = word.start
        if words:
            self._words.setdefault(utterance, held).extend(words)

    def interrupt(self, chunk: int, last: int | None = None) -> None:
        """Nobody will hear utterances up to `last` (None: all): end their gestures before the chunk."""
        self._words = {} if last is None else {at: words for at, words in self._words.items() if at > last}
        running = self._actions.running(chunk)
        if running is not None and running.concept:
            self._actions.stop(chunk)

    def gesture(self, chunk: int, liveliness: float, *, is_free: bool) -> None:
        """Begin the action that must start with this chunk, the next one to be made, for its stroke to meet its word.

        Args:
            chunk: number of the chunk; after a barge-in, chunks come again.
            liveliness: as the model is told it, 0 to 1; at 0.5 a concept's own chance holds.
            is_free: whether the session may gesture. A running action always goes first.
        """
        before = self._actions.gestures_before(chunk)
        if not self._words or not is_free or self._actions.running(chunk) is not None:
            return
        origins = self._queue.origins()
        self._forget(chunk, origins)
        past = {act.concept: chunk - act.begin for act in before}  # chunks since the last of each concept
        if min(past.values(), default=math.inf) < self._chunk.within(GAP_S):
            return
        for utterance in sorted(self._words.keys() & origins):
            words, origin = self._words[utterance], origins[utterance]
            now = (chunk * self._chunk.samples - origin) / SAMPLE_RATE_HZ
            first = bisect_left(words, now - self._chunk.seconds, key=_start)
            end = bisect_left(words, now + self._ahead_s, key=_start)
            for at in range(first, min(end, first + AT_ONCE)):
                concept = self._concept(words[at : at + PHRASE])
                if concept is None or past.get(concept.name, math.inf) < self._chunk.within(AGAIN_S):
                    continue
                draw = np.random.default_rng([self._seed, 3, utterance, round(1000 * words[at].start)])
                is_wanted = draw.random() < 2 * liveliness * concept.chance
                action = str(draw.choice(list(concept.leads)))
                stroke = round((origin / SAMPLE_RATE_HZ + words[at].start) / self._chunk.seconds)
                if is_wanted and stroke - concept.leads[action] == chunk:
                    self._actions.ask(action, chunk=chunk, is_own=True, concept=concept.name)
                    return

    def _concept(self, words: Sequence[Word]) -> _Concept | None:
        """The concept of the longest phrase that begins with the first of these words."""
        said = [" ".join(_TOKENS.findall(word.text.lower().replace("\u2019", "'"))) for word in words]
        for count in range(len(said), 0, -1):
            concept = self._concepts.get(" ".join(said[:count]))
            if concept is not None:
                return concept
        return self._concepts.get("?") if said[0].endswith("?") else None

    def _forget(self, chunk: int, origins: Mapping[int, int]) -> None:
        """Drop words whose time is long past."""
        newest, now = max(origins, default=0), chunk * self._chunk.samples
        for utterance, words in tuple(self._words.items()):
            if utterance in origins:
                long_ago = (now - origins[utterance]) / SAMPLE_RATE_HZ - PAST_S
                del words[: bisect_left(words, long_ago, key=_start)]
            if not words or utterance not in origins and utterance < newest:
                del self._words[utterance]


def _caption(cue: re.Match[str]) -> Word:
    *clock, text = cue.groups(default="0")
    first, last = (3600 * int(h) + 60 * int(m) + float(s.replace(",", ".")) for h, m, s in (clock[:3], clock[3:]))
    return Word(_TAG.sub("", text), first, last)


def _words_of(rows: Iterable[Sequence[Any]]) -> list[Word]:
    """Words of tuples: a text, its start and perhaps its end, which may be None.

    Raises EchoAvatarError if a row is something else.
    """
    try:
        return [
            Word(str(text), float(start), *(None if at is None else float(at) for at in end))
            for text, start, *end in rows
        ]
    except (TypeError, ValueError, OverflowError) as error:
        raise EchoAvatarError(f"words are tuples of a text, a start and perhaps an end in seconds: {error}") from error


def _check(word: Word, latest: float) -> None:
    """Raise EchoAvatarError for a word that is too long, has impossible times, or starts before `latest`."""
    text, start, end = word
    shown = repr(text[:20])
    if len(text) > LETTERS:
        raise EchoAvatarError(f"the word {shown} has {len(text):,} letters; send words of up to {LETTERS}")
    if not 0 <= start <= LATEST_S or (end is not None and not start <= end <= LATEST_S):
        raise EchoAvatarError(
            f"the word {shown} lasts from {start!r:.20} to {end!r:.20}; times are seconds, from 0 to {LATEST_S:,.0f}"
        )
    if start < latest:
        raise EchoAvatarError(f"the word {shown} at {start:g} s comes before one at {latest:g} s; send words in order")


def _concepts(library: ActionLibrary) -> dict[str, _Concept]:
    """The concept of each word and phrase of the table, if the library has an action for it."""
    found: dict[str, _Concept] = {}
    for language in _table().values():
        for name, row in language.items():
            leads = {action: library[action].hold[0] for action in row["actions"] if action in library}
            if leads:
                found |= dict.fromkeys(row["words"], _Concept(name, row["chance"], leads))
    return found


@cache
def _table() -> dict[str, dict[str, Any]]:
    return read_object_file(TABLE)
