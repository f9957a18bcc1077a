from types import SimpleNamespace

import numpy as np
import pytest
import torch

from echoavatar_lab.corpora.rehearsal.track import compose_track
from echoavatar_lab.tables import codec_probes
from echoavatar_lab.tables.codec_probes import Sound, _f_measure, known, score, train_reader


def test_events_count_once_within_70_ms() -> None:
    marks, strength = np.zeros(300), np.zeros(300)
    marks[[50, 100, 200]] = 1
    strength[[53, 108, 201]] = 1.0  # 40, 107 and 13 ms off
    assert _f_measure([(strength, marks)], 0.5) == pytest.approx(2 * 2 / 6)
    assert _f_measure([(strength, np.zeros(300)), (marks, marks)], 0.5) == 1.0


def test_what_is_known_of_a_track_lies_on_the_frames_of_the_codes() -> None:
    track = compose_track(4, 8.0, "speech", engine="own")
    sound = known(track)
    assert {len(part) for part in sound[1:]} == {600}
    assert set(np.unique(sound.domain)) <= {0, 1}
    assert sound.voiced[sound.domain == 1].mean() > 0.4
    assert sound.events[:, 2].sum() == 0
    assert sound.events[:, 1].sum() == pytest.approx(sum(s.prominence >= 0.45 for s in track.syllables), abs=1)


def test_a_reader_finds_what_the_codes_say_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)

    def sound(is_heard: bool) -> Sound:
        domain = np.repeat(rng.integers(0, 3, 20), 40)
        heard = domain if is_heard else rng.permutation(domain)
        return Sound(heard.astype(np.float32), domain, (domain == 1) * 1.0, 5.0 * domain, np.zeros((800, 3)))

    def codes(codec: object, audio: np.ndarray) -> np.ndarray:
        return np.stack([audio, 0 * audio], axis=1).astype(np.int16)

    monkeypatch.setattr(codec_probes, "audio_codes", codes)
    codec = SimpleNamespace(config=SimpleNamespace(codes=4), codebooks=torch.zeros(2, 4, 8))
    assert codec_probes.heard(None, np.zeros(3200, np.float32)).shape == (10, 64)
    for is_heard, low, high in ((True, 0.95, 1.0), (False, 0.0, 0.6)):
        reader, ends = train_reader(codec, [sound(is_heard) for _ in range(6)], steps=60, seed=0)
        assert low <= score(codec, reader, ends, [sound(is_heard) for _ in range(4)])["domain"] <= high
