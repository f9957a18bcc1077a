from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import AudioError, DependencyError, EchoAvatarError
from echoavatar.models.audio.io import write_wav
from echoavatar_lab.data import SoundSet
from echoavatar_lab.datasets import rl_corpus
from echoavatar_lab.datasets.conversations import Script
from echoavatar_lab.datasets.rl_corpus import SoundPlan, composed_music, make_rl_corpus, recorded_music
from echoavatar_lab.datasets.text_to_speech import Spoken


def clicks(seconds: float, bpm: float = 120) -> np.ndarray:
    time = np.arange(round(seconds * 24_000)) / 24_000
    phase = time % (60 / bpm)
    return (0.5 * np.sin(2 * np.pi * 220 * time) * np.exp(-phase * 20)).astype(np.float32)


def test_composed_pieces_know_their_beats_and_go_through_the_styles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rl_corpus, "COMPOSED_SECONDS", (5.0, 6.0))
    first, second = islice(composed_music(1), 2)
    take, again = first.make(), first.make()
    np.testing.assert_array_equal(take.audio, again.audio)
    assert take.notes["style"] != second.make().notes["style"]
    assert take.licence == "Apache-2.0"
    assert len(take.audio) == 800 * len(take.domain)
    np.testing.assert_allclose(np.median(np.diff(take.events["beats"])), 60 / float(take.notes["bpm"]), rtol=0.06)
    assert [job.split for job in islice(composed_music(1), 10)].count("test") == 1


def test_files_are_read_by_path_with_beats_measured(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    write_wav(tmp_path / "b/Höhe 1.wav", clicks(12), rate=24_000)
    write_wav(tmp_path / "a.wav", clicks(1), rate=24_000)
    short, piece = recorded_music(tmp_path, "CC0")
    assert piece.name.endswith("-H-he-1")
    take = piece.make()
    assert take.licence == "CC0"
    assert take.source.startswith("b/Höhe 1.wav, SHA-256 ")
    assert abs(np.median(np.diff(take.events["beats"])) - 0.5) < 0.02
    with pytest.raises(AudioError, match=r"a\.wav is shorter than 4 s"):
        short.make()


def test_long_files_are_cut_and_silent_ones_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rl_corpus, "LONGEST_SECONDS", 5.0)
    write_wav(tmp_path / "long.wav", clicks(12))
    write_wav(tmp_path / "mute.wav", np.zeros(24_000 * 5, np.float32))
    long, mute = recorded_music(tmp_path, "")
    take = long.make()
    assert 5 <= len(take.audio) / 24_000 < 6
    assert take.notes["cut"].startswith("after 5")
    with pytest.raises(AudioError, match=r"mute\.wav is silent"):
        mute.make()


def test_a_folder_without_music_is_named(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="holds no sound"):
        next(recorded_music(tmp_path, ""))


class Beeps:
    """Speaks ten seconds per script; refuses scripts of a name, and fails after a number of scripts."""

    title, licence = "beeps", "voices: none"

    def __init__(self, refuses: str = "no such name", lasts: int = 1000) -> None:
        self.refuses, self.lasts, self.read_names = refuses, lasts, list[str]()

    def read(self, script: Script, rng: np.random.Generator) -> Spoken:
        if self.refuses in script.name:
            raise AudioError("cannot be said")
        if len(self.read_names) == self.lasts:
            raise DependencyError("out of breath")
        self.read_names.append(script.name)
        sound = rng.normal(0, 0.1, 240_000).astype(np.float32)
        return Spoken(sound, np.ones(300, np.uint8), {"stress": (1.0, 2.0)}, ("high",))


@pytest.fixture
def music(tmp_path: Path) -> Path:
    folder = tmp_path / "music"
    folder.mkdir()
    for name in ("one", "two"):
        write_wav(folder / f"{name}.wav", clicks(6))
    return folder


def plan(tmp_path: Path, voice: Beeps, **changes: object) -> SoundPlan:
    known = {"folder": tmp_path / "out", "hours": 40 / 3600, "pieces": 2, "music": tmp_path / "music"}
    return SoundPlan(voice=voice, **(known | changes))  # type: ignore[arg-type]


def test_hours_and_pieces_are_made_and_listed(tmp_path: Path, music: Path) -> None:
    told: list[tuple[str, float, float]] = []
    found = make_rl_corpus(plan(tmp_path, Beeps(), music_licence="CC0"), lambda *three: told.append(three))
    assert (len(found.sounds("speech")), len(found.sounds("music"))) == (4, 2)
    assert told[-1] == ("music", 2, 2)
    assert [round(done * 60) for kind, done, _ in told if kind == "speech"] == [10, 20, 30, 40]
    sounds = SoundSet(tmp_path / "out")
    sounds.verify()
    assert {sound.licence for sound in sounds.sounds} == {"CC0", "text: Apache-2.0; voices: none"}
    speech = next(sound for sound in sounds.sounds if sound.kind == "speech")
    assert speech.source == "text: own conversations; spoken by beeps (high)"
    assert speech.events == {"stress": (1.0, 2.0)}
    assert "train" in speech.notes["text"]


def test_an_interrupted_run_continues_to_the_same_result(tmp_path: Path, music: Path) -> None:
    whole = tmp_path / "whole"
    make_rl_corpus(plan(tmp_path, Beeps(), folder=whole))
    with pytest.raises(DependencyError, match="out of breath"):
        make_rl_corpus(plan(tmp_path, Beeps(lasts=2)))
    assert len(SoundSet(tmp_path / "out").sounds) == 2
    found = make_rl_corpus(plan(tmp_path, second := Beeps()))
    assert (len(found.kept), len(found.made)) == (2, 4)
    assert len(second.read_names) == 2
    assert (tmp_path / "out/sounds.json").read_text() == (whole / "sounds.json").read_text()


def test_a_changed_file_is_made_again_and_smaller_wishes_forget_nothing(tmp_path: Path, music: Path) -> None:
    make_rl_corpus(plan(tmp_path, Beeps()))
    sounds = SoundSet(tmp_path / "out")
    sounds.path(sounds.sounds[0]).write_bytes(b"")
    found = make_rl_corpus(plan(tmp_path, Beeps(), hours=0, pieces=1))
    assert [len(found.made), len(found.kept)] == [1, 0]
    found = make_rl_corpus(plan(tmp_path, Beeps()))
    assert [len(found.made), len(found.kept)] == [0, 6]


def test_a_script_that_cannot_be_spoken_is_named_and_skipped(tmp_path: Path, music: Path) -> None:
    (music / "broken.mp3").write_bytes(b"nothing to hear")
    found = make_rl_corpus(plan(tmp_path, Beeps(refuses="0001"), pieces=3))
    assert [name for name, _ in found.failures] == ["speech-own-0001", found.failures[1][0]]
    assert "broken" in found.failures[1][0]
    assert len(found.sounds("speech")) == 4
    with pytest.raises(EchoAvatarError, match="5 scripts in a row failed, the last of them speech-own-0004"):
        make_rl_corpus(plan(tmp_path, Beeps(refuses="own"), folder=tmp_path / "other"))


def test_other_options_and_empty_plans_are_refused(tmp_path: Path, music: Path) -> None:
    make_rl_corpus(plan(tmp_path, Beeps()))
    with pytest.raises(EchoAvatarError, match="was made with seed 0, this call says 1"):
        make_rl_corpus(plan(tmp_path, Beeps(), seed=1))
    with pytest.raises(EchoAvatarError, match="ask for nothing"):
        make_rl_corpus(plan(tmp_path, Beeps(), hours=0, pieces=0))
    silent = Beeps()
    with pytest.raises(EchoAvatarError, match="holds no sound"):
        make_rl_corpus(plan(tmp_path, silent, music=tmp_path / "out" / "tokens", folder=tmp_path / "third"))
    assert not silent.read_names
