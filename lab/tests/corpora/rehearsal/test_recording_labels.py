from pathlib import Path

import numpy as np
import pytest
import soundfile
import soxr

from echoavatar.errors import AudioError
from echoavatar_lab.corpora.rehearsal.recording_labels import track_from_recording
from echoavatar_lab.corpora.rehearsal.track import compose_track

SHARED = Path(__file__).parents[4] / "../shared/data/audio_permissive"


def test_known_speech_labels_are_found_again():
    """Vowel centres of composed speech: most lie within 80 ms of an estimated nucleus, and the other way round."""
    known = compose_track(4, 20.0, "speech", engine="own")
    found = track_from_recording(known.audio, "speech")
    true = np.array([s.vowel for s in known.syllables if s.prominence >= 0.45])
    guess = np.array([s.vowel for s in found.syllables])
    assert np.mean([np.min(np.abs(guess - t)) < 0.08 for t in true]) > 0.75
    every = np.array([s.vowel for s in known.syllables])
    assert np.mean([np.min(np.abs(every - g)) < 0.1 for g in guess]) > 0.8


def test_breath_rumble_and_clicks_are_no_phrases():
    spoken = compose_track(4, 8.0, "speech", engine="own").audio
    rng, time = np.random.default_rng(0), np.arange(24_000) / 24_000
    breath = 0.01 * rng.standard_normal(24_000)
    rumble = 0.2 * np.sin(2 * np.pi * 12 * time)
    found = track_from_recording(np.concatenate([breath, rumble, spoken, rumble, breath]).astype(np.float32), "speech")
    assert 1.9 < found.phrases[0][0] < 3.5
    assert found.phrases[-1][1] < 10.1
    assert all(2.0 < syllable.vowel < 10.0 for syllable in found.syllables)


def test_known_music_labels_are_found_again():
    known = compose_track(11, 24.0, "music")
    found = track_from_recording(known.audio, "music")
    assert found.bpm > 0
    assert any(span.kind == "music" for span in found.spans)
    assert all(0 < section.energy <= 1 for section in found.sections)
    assert found.spans[-1].end == pytest.approx(found.seconds)


def test_music_with_a_stop_is_labelled_silent_after_it():
    known = compose_track(2, 12.0, "music")
    audio = np.concatenate([known.audio[: 8 * 24000], np.zeros(4 * 24000, np.float32)])
    found = track_from_recording(audio, "music")
    assert found.spans[-1].kind == "silence"
    assert found.beats.max() < 8.5


@pytest.mark.parametrize("audio", [np.zeros(100, np.float32), np.zeros((2, 48000)), np.full(48000, np.nan)])
def test_unusable_recordings_are_refused(audio):
    with pytest.raises(AudioError):
        track_from_recording(audio, "speech")


def test_an_unknown_kind_is_refused():
    with pytest.raises(AudioError, match="birdsong"):
        track_from_recording(np.zeros(48000, np.float32), "birdsong")


def test_real_speech_has_a_human_rate_of_syllables():
    files = sorted(SHARED.glob("speech_librispeech_cc_by/*.ogg"))
    if not files:
        pytest.skip(f"{SHARED} holds no recordings")
    audio, rate = soundfile.read(files[0], dtype="float32")
    found = track_from_recording(soxr.resample(audio, rate, 24000), "speech")
    spoken = sum(b - a for a, b in found.phrases)
    assert 2.5 < len(found.syllables) / spoken < 6
    assert 0.25 < sum(s.prominence >= 0.85 for s in found.syllables) / spoken < 1.2
