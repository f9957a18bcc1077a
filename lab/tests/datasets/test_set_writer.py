import json

import numpy as np
import pytest
from lab.tests.datasets.samples import gesture, motorica_names, renamed, speech, write_motion, write_pair

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import write_wav
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.data import Corpus
from echoavatar_lab.data.clip import Clip
from echoavatar_lab.datasets.layouts import OWN_FOLDER
from echoavatar_lab.datasets.prepare_recording import part_path, prepare_recording
from echoavatar_lab.datasets.set_writer import SetWriter, write_json
from echoavatar_lab.datasets.source import Recording, SetOptions

OPTIONS = SetOptions(fingers="keep")


def made(folder, name: str, split: str = "train", seconds: float = 1.0, options: SetOptions = OPTIONS):
    """The receipt of a part."""
    path = write_pair(folder / f"{name}.bvh", seconds)
    return prepare_recording(Recording(name, path, path.with_suffix(".wav"), split=split), options, folder / "set")


def writer(folder, options: SetOptions = OPTIONS) -> SetWriter:
    return SetWriter(folder / "set", "bvh", OWN_FOLDER, options)


def test_parts_become_a_corpus_that_reads_as_they_did(tmp_path):
    dataset = writer(tmp_path)
    parts = {}
    for name, split in (("a", "train"), ("b", "test")):
        dataset.add(made(tmp_path, name, split))
        parts[name] = Clip.load(part_path(tmp_path / "set", name))
    corpus = dataset.finish("folders")
    corpus.verify()
    assert corpus.names() == ["a", "a.mirror", "b"]
    for name, part in parts.items():
        whole = corpus.load(name)
        assert np.array_equal(whole.rotations, part.rotations)
        assert np.array_equal(whole.audio, part.audio)
        assert whole.split == part.split
        assert whole.events.keys() == part.events.keys()
    assert not (tmp_path / "set" / "parts").exists()
    assert corpus.skeleton is HUMANOID


def test_the_manifest_says_source_licence_splits_statistics_and_seed(tmp_path):
    dataset = writer(tmp_path, OPTIONS.model_copy(update={"seed": 7}))
    dataset.add(made(tmp_path, "a", options=OPTIONS.model_copy(update={"seed": 7})))
    dataset.add(made(tmp_path, "b", "test", 2.0, OPTIONS.model_copy(update={"seed": 7})))
    info = dataset.finish("folders").manifest.info
    assert info["licence"] == info["source"]["licence"] == OWN_FOLDER.licence
    assert (info["seed"], info["layout"], info["split_from"]) == (7, "bvh", "folders")
    numbers = info["statistics"]
    assert numbers["clips"] == {"train": 1, "test": 1}
    assert numbers["minutes"] == {"train": 0.017, "test": 0.033}
    assert len(numbers["features"]["mean"]) == len(numbers["features"]["std"]) == 315
    assert numbers["motion"]["wrist_speed_mean_m_s"] > 0.1
    assert sum(numbers["heard_minutes"].values()) == pytest.approx(0.05, abs=2e-3)


def test_full_shards_are_written_as_parts_come(tmp_path):
    options = OPTIONS.model_copy(update={"shard_minutes": 1.5 / 60})
    dataset = writer(tmp_path, options)
    for name in "abc":
        dataset.add(made(tmp_path, name, options=options))
    assert len(Corpus(tmp_path / "set").manifest.shards) == 1
    assert part_path(tmp_path / "set", "c").exists()
    corpus = dataset.finish("")
    assert [shard.frames for shard in corpus.manifest.shards] == [60, 30]
    assert corpus.entry("b").start == 30
    assert corpus.entry("c").shard == 1


def test_a_new_writer_continues_a_set(tmp_path):
    dataset = writer(tmp_path)
    first = made(tmp_path, "a")
    dataset.add(first)
    dataset.finish("")
    again = writer(tmp_path)
    assert again.holds("a", first.stamp)
    assert not again.holds("a", "other")
    assert not again.holds("b", first.stamp)
    again.add(made(tmp_path, "b"))
    assert again.finish("").names(has_mirrored=False) == ["a", "b"]


def test_a_recording_whose_files_changed_is_replaced(tmp_path):
    dataset = writer(tmp_path)
    dataset.add(made(tmp_path, "a"))
    dataset.finish("")
    again = writer(tmp_path)
    again.add(made(tmp_path, "a", seconds=2.0))
    corpus = again.finish("")
    assert corpus.names() == ["a", "a.mirror"]
    assert corpus.entry("a").frames == corpus.entry("a.mirror").frames == 60
    corpus.verify()


def test_splits_can_change_without_new_parts(tmp_path):
    dataset = writer(tmp_path)
    for name in "ab":
        dataset.add(made(tmp_path, name))
    dataset.finish("")
    again = writer(tmp_path)
    again.assign_splits({"a": "test"})
    assert again.finish("").names("test") == ["a"]
    assert Corpus(tmp_path / "set").names() == ["a", "b", "b.mirror"]


def test_mirror_images_are_for_training_and_only_if_wanted(tmp_path):
    plain = OPTIONS.model_copy(update={"mirror": False})
    dataset = writer(tmp_path, plain)
    dataset.add(made(tmp_path, "a", options=plain))
    assert dataset.finish("").names() == ["a"]


def test_a_set_with_other_options_is_refused(tmp_path):
    dataset = writer(tmp_path)
    dataset.add(made(tmp_path, "a"))
    dataset.finish("")
    with pytest.raises(EchoAvatarError, match="was made with fingers keep, this call says fingers all"):
        writer(tmp_path, SetOptions(fingers="all"))
    with pytest.raises(EchoAvatarError, match="holds bvh, not a set made from beat2"):
        SetWriter(tmp_path / "set", "beat2", OWN_FOLDER, OPTIONS)
    (tmp_path / "set" / "recordings.json").write_text("{")
    with pytest.raises(EchoAvatarError, match="recordings.json is missing or damaged"):
        writer(tmp_path)


def test_clips_without_sound_have_a_shard_of_their_own(tmp_path):
    any_sound = OPTIONS.model_copy(update={"sound": "any"})
    dataset = writer(tmp_path, any_sound)
    dataset.add(made(tmp_path, "a", options=any_sound))
    path = write_motion(tmp_path / "mute.bvh", gesture(1.0))
    dataset.add(
        prepare_recording(Recording("mute", path, tmp_path / "gone.wav", split="train"), any_sound, tmp_path / "set")
    )
    corpus = dataset.finish("")
    assert [("audio" in shard.sha256) for shard in corpus.manifest.shards] == [True, False]
    assert not corpus.entry("mute").has_sound
    assert not corpus.load("mute").audio.any()


def test_each_rig_has_its_own_shard(tmp_path):
    native = SetOptions(rig="native", fingers="keep")
    dataset = writer(tmp_path, native)
    dataset.add(made(tmp_path, "a", options=native))
    own = write_motion(tmp_path / "own.bvh", renamed(gesture(1.0), motorica_names()))
    write_wav(tmp_path / "own.wav", speech(1.0))
    dataset.add(prepare_recording(Recording("own", own, tmp_path / "own.wav", split="train"), native, tmp_path / "set"))
    corpus = dataset.finish("")
    assert corpus.skeleton_of("own").index("LeftForeArm")
    assert corpus.skeleton_of("a").index("leftLowerArm")
    assert corpus.motion("own").rotations.shape[1] == corpus.skeleton_of("own").joints
    assert "own.mirror" in corpus.names()
    assert corpus.manifest.info["statistics"]["features"] == {}


def test_json_is_written_completely_or_not_at_all(tmp_path):
    write_json(tmp_path / "a.json", {"b": 1})
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {"b": object()})
    assert json.loads((tmp_path / "a.json").read_text()) == {"b": 1}
