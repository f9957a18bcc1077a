import numpy as np
import pytest

from echoavatar_lab.corpora.dance.grooves import find_counts
from echoavatar_lab.corpora.sound import Section, SoundTrack, Span


def music(bpm: float, *, metre: int = 4, style: str = "", seconds: float = 20.0) -> SoundTrack:
    beats = 1.0 + np.arange(0, seconds, 60 / bpm)
    return SoundTrack(
        audio=np.zeros(int((seconds + 3) * 24_000), np.float32),
        spans=(Span(1.0, 1.0 + seconds, "music"),),
        beats=beats,
        downbeats=beats[::metre],
        sections=(Section(1.0, 9.0, 0.3), Section(9.0, 1.0 + seconds, 0.9)),
        style=style,
        bpm=bpm,
    )


def test_counts_are_beats_at_moderate_tempo() -> None:
    track = music(120, style="house")
    counts = find_counts(track, track.spans[0])
    np.testing.assert_allclose(counts.times, track.beats)
    assert (counts.metre, counts.unit, counts.groove.name) == (4, 1, "house")


def test_fast_music_is_danced_in_half_time_but_a_waltz_is_not() -> None:
    fast, waltz = music(180, style="salsa"), music(170, metre=3)
    assert find_counts(fast, fast.spans[0]).length(3) == pytest.approx(2 * 60 / 180)
    counts = find_counts(waltz, waltz.spans[0])
    assert counts.length(3) == pytest.approx(60 / 170)
    assert (counts.metre, counts.groove.name) == (3, "waltz")


def test_a_label_of_another_tempo_is_not_believed() -> None:
    track = music(124)
    wrong = SoundTrack(**{**vars(track), "style": "ballet", "bpm": 55.0})
    assert find_counts(wrong, wrong.spans[0]).groove.name == "house"


def test_sections_follow_each_other_without_a_gap() -> None:
    track = music(120)
    counts = find_counts(track, track.spans[0])
    assert [section[:2] for section in counts.sections] == [(0, 16), (16, len(counts.times))]
    assert [section[2] for section in counts.sections] == [0.3, 0.9]


def test_music_without_beats_gives_slow_counts_to_sway_by() -> None:
    track = SoundTrack(np.zeros(24_000 * 12, np.float32), spans=(Span(1.0, 11.0, "music"),))
    counts = find_counts(track, track.spans[0])
    assert counts.groove.name == "rest"
    assert counts.length(0) > 1.0


def test_counting_continues_beyond_both_ends() -> None:
    track = music(120)
    counts = find_counts(track, track.spans[0])
    assert counts.at(-1) == pytest.approx(0.5)
    assert counts.at(2.5) == pytest.approx(2.25)
    assert counts.at(len(counts.times)) == pytest.approx(counts.times[-1] + 0.5)
