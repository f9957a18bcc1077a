import csv
from pathlib import Path

import numpy as np
import pytest
import soundfile
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.formats import write_bvh
from echoavatar_lab.evaluation import takes


def write_sound(path: Path, seconds: float, seed: int = 0) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, np.random.default_rng(seed).normal(0, 0.1, int(seconds * 24_000)), 24_000)


def corpus(folder: Path) -> Path:
    """Six voices of three classes and two tracks, with a manifest."""
    listed = [
        ("a.wav", 6, "speech", "Reader 1 (F, Ann)", "English, read", "test"),
        ("b.wav", 6, "speech", "Reader 2 (M, Bob)", "English, read", "test"),
        ("c.wav", 6, "speech", "Reader 3 (F, Cat)", "English, read", "test"),
        ("d.wav", 12, "speech", "EmoDB 99 (m31)", "German, acted", "test"),
        ("e.wav", 12, "speech", "Reader 5 (F, Eve)", "English, read", "train"),
        ("f.wav", 6, "speech", "Reader 6 (M, Fox)", "English, read", "test"),
        ("g.wav", 14, "music", "A band", "jazz [excerpt]", "test"),
        ("h.wav", 3, "music", "A band", "jazz [excerpt]", "test"),
    ]
    for seed, (name, seconds, *_) in enumerate(listed):
        write_sound(folder / name, seconds, seed)
    with (folder / "manifest.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["path", "kind", "speaker_or_artist", "language_or_genre", "split"])
        writer.writerows([(name, *rest) for name, _, *rest in listed])
    return folder


def test_voices_of_a_class_are_joined_and_classes_take_turns(tmp_path: Path) -> None:
    """Training sounds, and what stays too short, are left out."""
    sounds = takes.read_sounds(corpus(tmp_path), 10, 3)
    assert [(s.name, s.kind, s.group, len(s.audio) / 24_000) for s in sounds] == [
        ("c", "speech", "English, female", 10),
        ("f", "speech", "English, male", 10),
        ("d", "speech", "German, male", 10),
        ("g", "music", "jazz", 10),
    ]
    assert [s.name for s in takes.read_sounds(tmp_path, 10, 1)] == ["c", "g"]


def test_without_a_manifest_folders_are_classes(tmp_path: Path) -> None:
    write_sound(tmp_path / "music/funk/x.wav", 4)
    write_sound(tmp_path / "ann/y.wav", 4)
    sounds = takes.read_sounds(tmp_path, 3, 5)
    assert [(s.kind, s.group) for s in sounds] == [("speech", "ann"), ("music", "funk")]
    with pytest.raises(EchoAvatarError, match="no speech or music of 20 s"):
        takes.read_sounds(tmp_path, 30, 5)


def name_people(folder: Path, *rows: tuple[str, str, str, str]) -> Path:
    """Write the folder's list of people: kind, person, use and the clip's name."""
    lines = [f"{','.join(row)}.bvh" for row in rows]
    (folder / "people.csv").write_text("\n".join(["kind,person,use,clip", *lines]) + "\n")
    return folder


def captured(folder: Path) -> Path:
    """Two people who talk and one who dances, named in a list; and a clip that the list leaves out."""
    folder.mkdir(exist_ok=True)
    for name in ("speech_a", "speech_b", "dance_a", "walk"):
        motion = swaying(400, size=0.2)
        write_bvh(folder / f"{name}.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    talkers = (("speech", "ann", "any", "speech_a"), ("speech", "bob", "any", "speech_b"))
    return name_people(folder, *talkers, ("music", "ann", "any", "dance_a"))
