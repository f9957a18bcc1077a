import pytest

from echoavatar_lab.corpora.speech.formant import _CONSONANTS, _VOWEL_FORMANTS
from echoavatar_lab.corpora.speech.pronounce import VOWELS, pronounce, syllabify
from echoavatar_lab.corpora.speech.vocabulary import SENTENCES, WORDS


@pytest.mark.parametrize(
    ("word", "phones"),
    [("river", "r ih v er"), ("bridge", "b r ih jh"), ("hide", "hh ay d"), ("change", "ch ey n jh"), ("I", "ay")],
)
def test_spelling_rules(word, phones):
    assert " ".join(pronounce(word)) == phones


def test_every_word_of_the_scripts_can_be_pronounced():
    words = {w for group in WORDS.values() for w in group}
    words |= {w for shape in SENTENCES.values() for template in shape for w in template.split() if w.isalpha()}
    known = set(_CONSONANTS) | set(_VOWEL_FORMANTS)
    for word in sorted(words):
        phones = pronounce(word)
        assert set(phones) <= known, word
        assert any(phone in VOWELS for phone in phones), word


def test_syllables_hold_all_phones_one_vowel_each_and_one_stress():
    for word in ("elephant", "tomorrow", "garden", "umbrella", "house"):
        parts = syllabify(word)
        assert tuple(p for phones, _ in parts for p in phones) == pronounce(word)
        assert all(sum(p in VOWELS for p in phones) == 1 for phones, _ in parts)
        assert sum(stressed for _, stressed in parts) == 1
    assert [stressed for _, stressed in syllabify("tomorrow")] == [False, True, False]
