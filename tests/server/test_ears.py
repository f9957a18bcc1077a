import sys
from types import SimpleNamespace

import numpy as np
import pytest

from echoavatar.server.ears import LONGEST_S, RATE_HZ, _core, _edits, _grammar

SPELT = {"wave": "W EY V", "raise": "R EY Z", "please": "P L IY Z", "the": "DH AH", "house": "HH AW S"}


@pytest.fixture
def understand(monkeypatch):
    """Ears for "wave", whose two decoders hear what a test says."""
    heard = {}

    class Decoder:
        def __init__(self, **_):
            self.lookup_word = SPELT.get

        def add_jsgf_string(self, name, text):
            assert "( wave )" in text, "a phrase with a word that nobody can spell is left out"

        def activate_search(self, name):
            self.name = name

        def start_utt(self): ...

        def process_raw(self, data, full_utt): ...

        def end_utt(self): ...

        def hyp(self):
            return SimpleNamespace(hypstr=heard[self.name]) if self.name in heard else None

        def nbest(self):
            return []

    monkeypatch.setitem(sys.modules, "pocketsphinx", SimpleNamespace(Decoder=Decoder))
    ears = _grammar(["wave", "xyzzy"])

    def ask(free, cue, seconds=1.0):
        heard.update(_default=free, cues=cue)
        return ears(np.zeros(int(seconds * RATE_HZ), np.float32))

    return ask


def test_a_phrase_counts_only_where_english_sounds_nearly_the_same(understand):
    assert understand("wave", "") == "wave"
    assert understand("please raise", "please wave(2)") == "please wave"
    assert understand("the house", "wave") == ""
    assert understand("the house", "please") == "", "courtesy alone is no phrase"
    assert understand("wave", "wave", seconds=LONGEST_S + 0.1) == ""


def test_the_courtesy_around_a_phrase_and_the_distance_of_two():
    assert (_core("please wave for me"), _core("wave")) == ("wave", "wave")
    assert (_edits("kitten", "sitting"), _edits("", "ab"), _edits("ab", "ab")) == (3, 2, 0)
