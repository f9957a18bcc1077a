"""Joins timed text of a voice, in pieces of any size such as letters, into words with times for an avatar."""

from math import nan

LETTERS, LATEST_S, WORDS = 100, 86_400.0, 2_000  # limits of the protocol: of a word, of its time, in a message
BACK_S = 0.1  # pieces of one voice may overlap by this much; a piece further back is left out

Word = tuple[str, float] | tuple[str, float, float]  # text, start and perhaps end in seconds


class TimedText:
    """The text of one utterance. Words end at white space; times are seconds from the utterance's first sample."""

    def __init__(self) -> None:
        self._ready: list[Word] = []
        self._word, self._start, self._end = "", nan, nan
        self._latest = 0.0  # start of the newest word

    def add(self, text: str, start: float, end: float = nan) -> None:
        """Add a piece, with times in seconds; NaN is an unknown time.

        The words of a piece share its time by their letters. Without an end, only its first word has a time.
        """
        words, at = text.split(), start
        if text[:1].isspace():
            self.close()
        per_letter = (end - start) / max(sum(map(len, words)), 1)
        for number, word in enumerate(words):
            if number:
                self.close()
            if not self._word:
                self._start = at
            if len(self._word) <= LETTERS:
                self._word += word
            self._end = at = at + per_letter * len(word)
        if text[-1:].isspace():
            self.close()

    def close(self) -> None:
        """End the open word. A word without a time, or with an impossible one, is left out."""
        text, start, end = self._word, max(self._start, self._latest), self._end
        is_timed = self._latest - BACK_S <= self._start <= LATEST_S
        if is_timed and 0 < len(text) <= LETTERS and len(self._ready) < WORDS:
            self._ready.append((text, start, end) if start <= end <= LATEST_S else (text, start))
            self._latest = start
        self._word = ""

    def take(self) -> list[Word]:
        """The words completed since the last call."""
        words, self._ready = self._ready, []
        return words
