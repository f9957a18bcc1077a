import numpy as np
import pytest

from echoavatar_lab.corpora.speech.prosody import (
    Delivery,
    SpokenSyllable,
    draw_delivery,
    lift_nuclei,
    score_prominence,
    shape_pitch,
)
from echoavatar_lab.corpora.speech.script import Word


def syllable(start: float, word: int, stressed: bool = True, prominence: float = 0.0) -> SpokenSyllable:
    return SpokenSyllable(start, start + 0.2, start + 0.1, word, stressed, False, prominence)


def test_the_last_content_word_of_a_phrase_is_nuclear():
    words = (Word("the"), Word("garden"), Word("was"), Word("green"), Word("for"), Word("me"))
    scored = score_prominence(tuple(syllable(0.2 * i, i) for i in range(6)), words)
    assert [s.prominence for s in scored] == [0.1, 0.45, 0.1, 0.85, 0.1, 0.1]


def test_a_focus_takes_the_nucleus_away():
    words = (Word("the"), Word("red", is_focus=True), Word("house"))
    scored = score_prominence(tuple(syllable(0.2 * i, i) for i in range(3)), words)
    assert [s.prominence for s in scored] == [0.1, 1.0, 0.45]


def test_each_breath_group_has_its_own_nucleus():
    words = (Word("green"), Word("house"))
    scored = score_prominence((syllable(0.0, 0), syllable(0.5, 1)), words)
    assert [s.prominence for s in scored] == [0.85, 0.85]


def test_pitch_rises_on_a_prominent_vowel_and_stays_zero_where_unvoiced():
    f0 = np.full(200, 100, np.float32)
    f0[150:] = 0
    shaped = shape_pitch(
        f0,
        frame_s=0.005,
        syllables=(syllable(0.3, 0, prominence=1.0),),
        delivery=Delivery(bump_semitones=4.0),
        is_question=False,
    )
    assert np.argmax(shaped) == 80  # 0.4 s
    assert shaped[80] == pytest.approx(100 * 2 ** (4 / 12), rel=0.01)
    assert (shaped[150:] == 0).all()


def test_a_question_ends_high():
    f0 = np.full(100, 100, np.float32)
    shaped = shape_pitch(f0, frame_s=0.005, syllables=(syllable(0.3, 0),), delivery=Delivery(), is_question=True)
    assert shaped[-1] > 1.3 * shaped[0]


def test_silence_has_no_pitch_to_shape():
    f0 = np.zeros(10, np.float32)
    assert (shape_pitch(f0, frame_s=0.005, syllables=(), delivery=Delivery(), is_question=False) == 0).all()


def test_nuclei_are_louder_by_the_asked_decibels():
    audio = lift_nuclei(np.ones(24000, np.float32), 24000, (syllable(0.4, 0, prominence=1.0),), 6.0)
    assert audio[12000] == pytest.approx(10 ** (6 / 20), rel=0.01)
    assert audio[0] == 1


def test_speakers_differ_and_use_the_given_voices():
    rng = np.random.default_rng(0)
    speakers = [draw_delivery(rng, ("a", "b")) for _ in range(20)]
    assert {s.voice for s in speakers} == {"a", "b"}
    assert len({s.rate for s in speakers}) == 20
