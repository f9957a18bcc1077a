"""stub."""

from .prosody import Delivery, Utterance
from .script import Word

FORMANT_VOICES = ("alto", "tenor", "bass")


def say(words: tuple[Word, ...], delivery: Delivery, seed: int) -> Utterance:
    raise NotImplementedError
