import numpy as np

from echoavatar_lab.corpora.sound import (
    Section,
    SoundTrack,
    Span,
    Syllable,
    concatenate,
    cut,
    merge_spans,
    shift,
    whole_frames,
)


def made(seconds: float, kind: str, style: str = "") -> SoundTrack:
    return SoundTrack(
        audio=np.full(round(seconds * 24000), 0.1, np.float32),
        spans=(Span(0.0, seconds, kind),),
        syllables=(Syllable(0.1, 0.3, 0.2, 0.9, "yes", ""),),
        phrases=((0.1, 0.3),),
        phones=((0.1, 0.3, "eh"),),
        beats=np.array([0.0, 0.5]),
        downbeats=np.array([0.0]),
        sections=(Section(0.0, seconds, 0.5),),
        style=style,
        bpm=120.0 if style else 0.0,
    )


def test_audio_is_padded_to_whole_motion_frames():
    assert len(whole_frames(np.ones(1, np.float32))) == 800
    assert len(whole_frames(np.ones(1600, np.float32))) == 1600
    assert whole_frames(np.ones(801)).dtype == np.float32


def test_shift_moves_every_label_and_back_again():
    track = made(1.0, "speech")
    moved = shift(track, 2.0)
    assert moved.spans[0].start == 2.0
    assert moved.syllables[0].vowel == 2.2
    assert moved.beats.tolist() == [2.0, 2.5]
    assert moved.sections[0].end == 3.0
    assert shift(moved, -2.0).spans == track.spans


def test_concatenated_labels_follow_their_audio():
    joined = concatenate([made(1.0, "speech"), made(2.0, "speech"), made(1.5, "music", "waltz")])
    assert joined.seconds == 4.5
    assert joined.spans == (Span(0.0, 3.0, "speech"), Span(3.0, 4.5, "music"))
    assert [round(s.vowel, 6) for s in joined.syllables] == [0.2, 1.2, 3.2]
    assert joined.beats.tolist() == [0.0, 0.5, 1.0, 1.5, 3.0, 3.5]
    assert (joined.style, joined.bpm) == ("waltz", 120.0)


def test_nothing_joined_is_an_empty_track():
    assert concatenate([]).seconds == 0


def test_empty_spans_vanish_when_merged():
    spans = [Span(0, 1, "silence"), Span(1, 1, "speech"), Span(1, 2, "silence")]
    assert merge_spans(spans) == (Span(0, 2, "silence"),)


def test_cut_drops_later_labels_and_shortens_running_ones():
    short = cut(made(2.0, "music", "rock"), 0.4)
    assert len(short.audio) == 9600
    assert short.spans == (Span(0.0, 0.4, "music"),)
    assert short.beats.tolist() == [0.0]
    assert short.sections[0].end == 0.4
    assert len(short.syllables) == 1
    assert cut(made(2.0, "music"), 0.2).syllables == ()
