import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import soundfile

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.corpora.gesture.speakers import Manner
from echoavatar_lab.corpora.rehearsal.corpus import TEST_EVERY, Plan, domains, make_clip, rehearse
from echoavatar_lab.corpora.rehearsal.track import compose_track
from echoavatar_lab.corpora.sound import SoundTrack, Span
from echoavatar_lab.data import Corpus

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


def test_recordings_are_half_of_the_sound_and_named(tmp_path: Path, own_cache: Path) -> None:
    (tmp_path / "music").mkdir()
    beat = np.zeros(12_000, np.float32)
    beat[:1200] = 0.3 * np.exp(-np.arange(1200) / 200) * np.random.default_rng(0).standard_normal(1200)
    soundfile.write(tmp_path / "music" / "clicks.wav", np.tile(beat, 24), 24_000)
    heard = [compose_track(seed, 6.0, "music", recordings=tmp_path) for seed in range(20)]
    names = [source.name for track in heard for source in track.sources if source.kind == "music"]
    assert 0.25 < np.mean([name == "clicks" for name in names]) < 0.75
    assert any(source.kind == "singing" for track in heard for source in track.sources)
    clips = [make_clip(plan(tmp_path / "out", recordings=tmp_path), index) for index in (0, 0)]
    assert np.array_equal(clips[0].audio, clips[1].audio)
    assert all(start < end for start, end, *_ in json.loads(clips[0].labels["sources"]))


def test_a_clip_says_whose_manner_it_has(tmp_path: Path) -> None:
    said = [json.loads(make_clip(plan(tmp_path), index).labels["manner"]) for index in range(2)]
    assert said[0] != said[1]
    assert set(said[0]) == {field.name for field in fields(Manner)}


def test_held_out_clips_hear_no_recordings_but_those_of_train(tmp_path: Path, own_cache: Path) -> None:
    for name in ("train", "dev", "test"):
        soundfile.write(tmp_path / f"{name}.wav", np.random.default_rng(0).normal(0, 0.1, 96_000), 24_000)
    rows = [f"{name}.wav,4,music,Band of {name},{name},pop,{name}" for name in ("train", "dev", "test")]
    head = "path,seconds,kind,speaker_or_artist,title,language_or_genre,split"
    (tmp_path / "manifest.csv").write_text("\n".join([head, *rows]))
    tracks = [compose_track(seed, 4.0, "music", split="test", recordings=tmp_path) for seed in range(8)]
    heard = {source.name for track in tracks for source in track.sources if "Band" in source.name}
    assert heard == {"Band of train: train"}


def test_a_corpus_has_the_same_fingerprint_for_any_number_of_workers(tmp_path: Path) -> None:
    tiny = [replace(plan(tmp_path / name), clip_seconds=2.0, hours=4 / 3600) for name in ("a", "b", "c")]
    rehearse(tiny[0])
    rehearse(tiny[1], workers=2)
    rehearse(replace(tiny[2], seed=6))
    first, again, other = (Corpus(one.folder).fingerprint for one in tiny)
    assert first == again != other


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
