from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import AudioError
from echoavatar.models.audio.io import write_wav
from echoavatar_lab.data import Sound, SoundSet
from echoavatar_lab.data.corpus import checksum
from echoavatar_lab.data.sounds import runs, save_sounds


@pytest.fixture
def one(tmp_path: Path) -> Sound:
    write_wav(tmp_path / "one.wav", np.sin(np.arange(2400) / 20).astype(np.float32) / 2)
    return Sound(
        name="one", file="one.wav", kind="music", frames=3, sha256=checksum(tmp_path / "one.wav"), source="here",
        licence="Apache-2.0", heard=((0, 1), (2, 2)), events={"beats": (0.05,)},
    )  # fmt: skip


def test_saved_sounds_are_read_back(tmp_path: Path, one: Sound) -> None:
    sounds = save_sounds(tmp_path, [one], {"seed": 3})
    assert SoundSet(tmp_path).sounds == sounds.sounds == [one]
    assert SoundSet(tmp_path).info == {"seed": 3}
    sounds.verify()
    assert one.seconds == 0.1
    assert one.domain.tolist() == [0, 2, 2]
    np.testing.assert_allclose(sounds.load(one), np.sin(np.arange(2400) / 20) / 2, atol=1e-4)


def test_runs_are_kinds_with_lengths() -> None:
    domain = np.array([1, 1, 0, 2, 2, 2], np.uint8)
    assert runs(domain) == ((1, 2), (0, 1), (2, 3))


def test_changed_missing_and_foreign_files_are_named(tmp_path: Path, one: Sound) -> None:
    sounds = save_sounds(tmp_path, [one], {})
    write_wav(tmp_path / "one.wav", np.zeros(1600, np.float32))
    assert not sounds.is_intact(one)
    with pytest.raises(AudioError, match=r"one\.wav is missing or changed"):
        sounds.verify()
    with pytest.raises(AudioError, match=r"one\.wav holds \(1600,\) samples at 24000 Hz"):
        sounds.load(one)
    (tmp_path / "one.wav").unlink()
    with pytest.raises(AudioError, match=r"one\.wav cannot be read"):
        sounds.load(one)
    (tmp_path / "sounds.json").write_text('{"sounds": [{}]}')
    with pytest.raises(AudioError, match="damaged"):
        SoundSet(tmp_path)
    with pytest.raises(AudioError, match=r"sounds\.json is missing"):
        SoundSet(tmp_path / "nowhere")
