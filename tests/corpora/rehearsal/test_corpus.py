from pathlib import Path

import numpy as np
import pytest
import soundfile

from echoavatar.corpora.rehearsal.corpus import TEST_EVERY, Plan, domains, make_clip, rehearse
from echoavatar.corpora.rehearsal.sound import SoundTrack, Span
from echoavatar.data import Corpus
from echoavatar.errors import EchoAvatarError

SHORT = 10.0


def plan(folder: Path, **more: object) -> Plan:
    return Plan(hours=2.1 * SHORT / 3600, seed=5, folder=folder, clip_seconds=SHORT, **more)  # type: ignore[arg-type]


def test_a_clip_follows_from_its_seed_and_index(tmp_path: Path) -> None:
    first, again = (make_clip(plan(tmp_path), 0) for _ in range(2))
    assert np.array_equal(first.audio, again.audio)
    assert np.array_equal(first.rotations, again.rotations)
    assert not np.array_equal(first.audio, make_clip(plan(tmp_path), 1).audio)


def test_one_clip_in_sixteen_is_held_out(tmp_path: Path) -> None:
    assert make_clip(plan(tmp_path), TEST_EVERY - 1).split == "test"
    assert make_clip(plan(tmp_path), 0).split == "train"


def test_an_interrupted_run_continues_and_ends_with_a_manifest(tmp_path: Path) -> None:
    rehearse(plan(tmp_path))
    corpus = Corpus(tmp_path)
    corpus.verify()
    lost = corpus.path(corpus.names()[0])
    kept = corpus.path(corpus.names()[1]).stat().st_mtime_ns
    lost.unlink()
    told: list[tuple[int, int]] = []
    rehearse(plan(tmp_path), progress=lambda done, total: told.append((done, total)))
    assert told == [(2, 2)]
    assert corpus.path(corpus.names()[1]).stat().st_mtime_ns == kept
    assert "synthetic" in Corpus(tmp_path).manifest.info["kind"]


def test_recordings_are_moved_to_by_their_kind(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "music").mkdir()
    clicks = np.zeros(24_000 * 12, np.float32)
    for start in range(0, len(clicks), 12_000):
        clicks[start : start + 1200] = rng.standard_normal(1200) * np.exp(-np.arange(1200) / 200)
    soundfile.write(tmp_path / "music" / "clicks.wav", clicks * 0.3, 24_000)
    clip = make_clip(plan(tmp_path / "out", recordings=tmp_path), 1)
    assert set(np.unique(clip.domain)) <= {0, 2}
    assert (clip.domain == 2).any()
    assert len(clip.events["beats"]) > 3


def test_frames_are_labelled_by_their_span() -> None:
    track = SoundTrack(np.zeros(24_000 * 3, np.float32), (Span(0.0, 1.0, "speech"), Span(2.0, 3.0, "music")))
    assert domains(track, 90).tolist() == [1] * 30 + [0] * 30 + [2] * 30


@pytest.mark.parametrize("hours", [0.0, -1.0])
def test_no_hours_are_refused(tmp_path: Path, hours: float) -> None:
    with pytest.raises(EchoAvatarError, match="must be positive"):
        rehearse(Plan(hours, 0, tmp_path))


def test_an_empty_folder_of_recordings_is_named(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="holds no sound"):
        make_clip(plan(tmp_path, recordings=tmp_path), 1)
