import numpy as np
import pytest

from echoavatar_lab.corpora.rehearsal.track import compose_track


def rms(track, span) -> float:
    part = track.audio[round(span.start * 24000) : round(span.end * 24000)]
    return float(np.sqrt(np.mean(part**2)))


@pytest.mark.parametrize("mix", ["mixed", "speech", "music"])
def test_a_track_is_exactly_as_long_as_asked_and_fully_labelled(mix):
    track = compose_track(1, 20.0, mix, engine="own")
    assert len(track.audio) == 600 * 800
    assert track.audio.dtype == np.float32
    assert np.isfinite(track.audio).all()
    assert np.abs(track.audio).max() < 1
    assert track.spans[0].start == 0
    assert track.spans[-1].end == pytest.approx(20.0)
    assert all(a.end == pytest.approx(b.start) for a, b in zip(track.spans, track.spans[1:], strict=False))


@pytest.mark.parametrize("engine", ["own", "auto"])
def test_the_same_seed_gives_the_same_bits(engine):
    first = compose_track(5, 15.0, engine=engine)
    compose_track(6, 5.0, "speech", engine=engine)
    again = compose_track(5, 15.0, engine=engine)
    assert np.array_equal(first.audio, again.audio)
    for name, value in vars(first).items():
        np.testing.assert_array_equal(value, getattr(again, name), name)


def test_other_seeds_and_the_test_split_sound_different():
    tracks = [compose_track(5, 10.0, "speech", engine="own"), compose_track(6, 10.0, "speech", engine="own")]
    tracks.append(compose_track(5, 10.0, "speech", engine="own", split="test"))
    assert not np.array_equal(tracks[0].audio, tracks[1].audio)
    assert not np.array_equal(tracks[0].audio, tracks[2].audio)


def test_labels_stay_in_their_spans():
    for seed in range(2):
        track = compose_track(seed, 30.0, engine="own")
        speech = [s for s in track.spans if s.kind == "speech"]
        music = [s for s in track.spans if s.kind == "music"]
        for syllable in track.syllables:
            assert any(s.start - 0.01 <= syllable.vowel <= s.end + 0.01 for s in speech)
        for beat in track.beats:
            assert any(s.start - 0.01 <= beat <= s.end + 0.01 for s in music)


def test_silence_is_much_quieter_than_sound():
    track = compose_track(3, 40.0, engine="own")
    quiet = [rms(track, s) for s in track.spans if s.kind == "silence" and s.end - s.start > 1]
    loud = [rms(track, s) for s in track.spans if s.kind != "silence"]
    assert quiet
    assert loud
    assert np.median(quiet) < 0.15 * np.median(loud)


def test_a_mix_holds_only_its_kind_of_sound():
    assert len(compose_track(2, 15.0, "music").beats) > 4
    assert not len(compose_track(2, 15.0, "speech", engine="own").beats)


def test_an_unknown_mix_is_refused():
    with pytest.raises(ValueError, match="noise"):
        compose_track(0, 1.0, "noise")
