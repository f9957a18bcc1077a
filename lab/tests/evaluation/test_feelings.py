import numpy as np
import pytest
import soundfile

from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_lab.evaluation.feelings import NAMES, acted_speech, as_text, read_feelings


@pytest.fixture
def folder(tmp_path):
    """Two speakers with a hiss for each feeling, one of them by a manifest; and a file that says nothing."""
    draw = np.random.default_rng(0)
    for number, name in enumerate(("neutral", "joy", "anger", "sadness")):
        hiss = (0.05 * (1 + number) * draw.normal(size=SAMPLE_RATE_HZ)).astype(np.float32)
        soundfile.write(tmp_path / f"ann_{name}.wav", hiss, SAMPLE_RATE_HZ)
        soundfile.write(tmp_path / f"{number}.wav", hiss, SAMPLE_RATE_HZ)
    rows = [
        f"{number}.wav,take {name},Ben,test" for number, name in enumerate(("neutral", "happiness", "angry", "sad"))
    ]
    (tmp_path / "manifest.csv").write_text("\n".join(["path,title,speaker_or_artist,split", *rows]))
    soundfile.write(tmp_path / "unhappy.wav", np.zeros(800), SAMPLE_RATE_HZ)
    return tmp_path


def test_feelings_and_speakers_are_read_from_titles_and_names(folder):
    found = acted_speech(folder)
    assert sorted((each.speaker, NAMES[each.feeling], each.split) for each in found) == sorted(
        [("Ben", name, "test") for name in NAMES] + [("ann", name, "other") for name in NAMES]
    )
    with pytest.raises(EchoAvatarError, match="two speakers"):
        acted_speech(folder / "nothing")


def test_each_recording_is_read_once_and_by_the_faces_of_others(folder):
    """Ben's and Ann's sounds are the same, so each is read by its twin; without a face there is nothing to read."""
    readings = read_feelings(load_bundle(), acted_speech(folder))
    assert set(readings) == {"test", "other"}
    for reading in readings.values():
        assert np.array_equal(reading.confusion, np.eye(4, dtype=int))
        assert reading.right == 1
    assert "test: 100% right" in as_text(readings)
    with pytest.raises(EchoAvatarError, match="no face model"):
        read_feelings(load_bundle().without(["face"]), acted_speech(folder))
