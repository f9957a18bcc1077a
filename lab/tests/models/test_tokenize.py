"""Sound alone becomes prompts that say they are no truth."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.models.audio.io import write_wav
from echoavatar.models.generator.manner import TOLD, Manner
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.timing import CHUNK_SAMPLES
from echoavatar_lab.data import Clip, Corpus, Sound, SoundSet, write_manifest
from echoavatar_lab.data.corpus import checksum
from echoavatar_lab.data.sounds import save_sounds
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenize import audio_codes, cues_at, hands_of, own_motion, tokenize_corpus, tokenize_sounds


def corpus(folder: Path, swaying: tuple[np.ndarray, np.ndarray], voice: np.ndarray) -> Corpus:
    rotations, root = swaying
    audio = np.resize(voice, 96 * 800)
    domain = np.repeat(np.array([0, 1, 2], np.uint8), 32)
    turned = quaternion_from_matrix(rotations)
    Clip("one", audio, turned, root, domain).save(folder / "clips" / "one.npz")
    return write_manifest(folder)


def test_every_clip_gets_codes_and_its_mirror_image_shares_the_sound(
    tiny_bundle: Path, tmp_path: Path, swaying: tuple[np.ndarray, np.ndarray], voice: np.ndarray
) -> None:
    """96 frames are 12 chunks: 240 audio frames, 24 motion steps."""
    bundle = load_bundle(tiny_bundle)
    made = tokenize_corpus(corpus(tmp_path, swaying, voice), bundle.codec, bundle.tokenizer, tmp_path / "tokens")
    assert made == 2
    own, mirror = (TokenClip.load(tmp_path / "tokens/one.npz"), TokenClip.load(tmp_path / "tokens/one.mirror.npz"))
    assert own.audio.shape == (240, 2)
    assert own.motion.shape == (24, 3, 2)
    assert np.array_equal(own.audio, mirror.audio)
    assert not np.array_equal(own.motion, mirror.motion)
    assert own.domain.tolist() == [0] * 8 + [1] * 8 + [2] * 8


def test_a_manner_comes_with_its_clip_and_its_mirror_image_leads_with_the_other_hand(
    tiny_bundle: Path, tmp_path: Path, swaying: tuple[np.ndarray, np.ndarray], voice: np.ndarray
) -> None:
    bundle, source = load_bundle(tiny_bundle), corpus(tmp_path, swaying, voice)
    told = Manner(right=0.9, liveliness=0.25)
    labelled = replace(source.load("one"), labels={"manner": json.dumps(asdict(told))})
    labelled.save(tmp_path / "clips" / "one.npz")
    tokenize_corpus(write_manifest(tmp_path), bundle.codec, bundle.tokenizer, tmp_path / "tokens")
    own, mirror = (TokenClip.load(tmp_path / f"tokens/one{name}.npz") for name in ("", ".mirror"))
    assert own.manner.shape == (24, len(TOLD))
    assert own.manner[:, :-4] == pytest.approx(np.tile(told.values, (24, 1)))
    assert mirror.manner[:, :-4] == pytest.approx(np.tile(replace(told, right=0.1).values, (24, 1)))
    hands, mirrored = own.manner[:, -4:], mirror.manner[:, -4:]
    assert np.array_equal(hands, mirrored[:, [1, 0, 3, 2]], equal_nan=True)
    assert np.isnan(hands[16:]).all(), "those of a dance are not told"
    assert ((hands[:16] >= 0) & (hands[:16] <= 1)).all()


def test_a_hand_is_busy_while_it_moves_and_hangs_an_arm_below_its_shoulder() -> None:
    """The right forearm swings by 60 degrees each second; the left arm hangs, and the whole body turns."""
    t = np.arange(240) / 30
    rotations = np.zeros((240, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    swing = np.radians(30) * np.sin(2 * np.pi * t) * (t < 4)
    rotations[:, HUMANOID.index("rightLowerArm")] = np.stack([np.cos(swing / 2), 0 * t, np.sin(swing / 2), 0 * t], 1)
    rotations[:, HUMANOID.index("leftUpperArm")] = (0.5**0.5, 0, 0, -(0.5**0.5))  # down from the stretched rest pose
    rotations[:, HUMANOID.index("hips")] = np.stack([np.cos(t / 4), 0 * t, np.sin(t / 4), 0 * t], 1)
    speeds, heights = hands_of(Motion(HUMANOID, rotations, np.zeros((240, 3), np.float32), 30.0))
    left, right = speeds.T
    assert left.max() < 0.01
    assert right[10:110].mean() > 0.5
    assert right[130:].max() < 0.01
    assert heights[:, 0] == pytest.approx(-1, abs=0.1)
    assert heights[130:, 1] == pytest.approx(0, abs=0.1), "the right arm is stretched out"


def test_a_dancer_dances_to_the_music_and_all_else_stays_true(
    tiny_bundle: Path, tmp_path: Path, swaying: tuple[np.ndarray, np.ndarray], voice: np.ndarray
) -> None:
    """12 chunks: 4 of silence, 4 of speech, 4 of music; the dance has the 8 before as its past."""
    bundle, source = load_bundle(tiny_bundle), corpus(tmp_path, swaying, voice)
    tokenize_corpus(source, bundle.codec, bundle.tokenizer, tmp_path / "true", is_mirrored_too=False)
    tokenize_corpus(
        source, bundle.codec, bundle.tokenizer, tmp_path / "danced", is_mirrored_too=False, dancer=bundle.generator
    )
    true = TokenClip.load(tmp_path / "true/one.npz")
    talk, dance, end = (TokenClip.load(tmp_path / f"danced/one.{number}.npz") for number in range(3))
    assert np.array_equal(talk.motion, true.motion[:16])
    assert np.array_equal(dance.audio, true.audio[-len(dance.audio) :])
    assert np.array_equal(dance.motion[:-8], true.motion[-len(dance.motion) : -8])
    assert not np.array_equal(dance.motion[-8:], true.motion[-8:])
    assert np.array_equal(end.motion, true.motion[16:])  # the true end of the dance, and what follows


def test_patient_codes_change_less_often_and_say_so(
    tiny_bundle: Path, tmp_path: Path, swaying: tuple[np.ndarray, np.ndarray], voice: np.ndarray
) -> None:
    bundle, source = load_bundle(tiny_bundle), corpus(tmp_path, swaying, voice)
    changes = []
    for patience in (0.0, 2.0):
        folder = tmp_path / f"tokens {patience}"
        tokenize_corpus(source, bundle.codec, bundle.tokenizer, folder, patience=patience)
        clip = TokenClip.load(folder / "one.npz")
        assert clip.patience == patience
        changes.append(int((np.diff(clip.motion, axis=0) != 0).sum()))
    assert changes[1] < changes[0]


def test_what_is_there_is_not_made_again(
    tiny_bundle: Path, tmp_path: Path, swaying: tuple[np.ndarray, np.ndarray], voice: np.ndarray
) -> None:
    bundle, source = load_bundle(tiny_bundle), corpus(tmp_path, swaying, voice)
    tokenize_corpus(source, bundle.codec, bundle.tokenizer, tmp_path / "tokens")
    before = (tmp_path / "tokens/one.npz").stat().st_mtime_ns
    tokenize_corpus(source, bundle.codec, bundle.tokenizer, tmp_path / "tokens")
    assert (tmp_path / "tokens/one.npz").stat().st_mtime_ns == before


def test_codes_are_those_that_a_stream_hears(tiny_bundle: Path, voice: np.ndarray) -> None:
    bundle = load_bundle(tiny_bundle)
    from echoavatar.models.audio import LevelControl

    level, one = LevelControl(), np.ones(1, np.bool_)
    heard, coded, out = level.init_state(1), bundle.codec.init_state(1), []
    for start in range(0, 6400 * 7, 6400):
        chunk = torch.from_numpy(level.step(voice[None, start : start + 6400], heard, one))
        out.append(bundle.codec.step(chunk, coded, torch.from_numpy(one))[0].numpy())
    whole = audio_codes(bundle.codec, voice[: 6400 * 7])
    assert (np.concatenate(out) == whole).mean() > 0.99  # a near tie may fall the other way


def test_cues_are_on_for_three_frames_from_each_event() -> None:
    rotations, root = np.tile(np.float32([1, 0, 0, 0]), (30, 52, 1)), np.zeros((30, 3), np.float32)
    events = {"beats": np.array([0.0, 0.4]), "stress": np.array([0.99])}
    clip = Clip("one", np.zeros(24_000, np.float32), rotations, root, np.full(30, 2, np.uint8), events)
    cues = cues_at(clip.events, 75)
    assert np.flatnonzero(cues[:, 0]).tolist() == [0, 1, 2, 30, 31, 32]
    assert np.flatnonzero(cues[:, 1]).tolist() == [74]


def test_sound_is_leveled_only_where_the_pipeline_levels_it(tiny_bundle: Path, voice: np.ndarray) -> None:
    """The codes are those that a pipeline of that runtime hears, chunk for chunk."""
    bundle = load_bundle(tiny_bundle).having(codec=load_bundle().codec)  # the tiny one knows one code only
    quiet = 0.05 * voice[: CHUNK_SAMPLES * 6]
    for runtime, is_leveled in (("paper", False), ("level", True)):
        pipeline = Pipeline(bundle.running(runtime))
        state, one = pipeline.init_state(1), np.ones(1, np.bool_)
        heard = []
        for chunk in np.split(quiet, 6):
            level = pipeline.level.step(chunk[None], state.level, one) if pipeline.level else chunk[None]
            heard.append(pipeline.encode_audio(level, state, one)[0])
        codes = audio_codes(bundle.codec, quiet, is_leveled=is_leveled)
        assert (np.concatenate(heard) == codes).mean() > 0.99  # a near tie may fall the other way
    assert not np.array_equal(audio_codes(bundle.codec, quiet), audio_codes(bundle.codec, quiet, is_leveled=False))


def sounds(folder: Path, voice: np.ndarray) -> SoundSet:
    write_wav(folder / "one.wav", np.resize(voice, 60 * 800))
    one = Sound(
        name="one", file="one.wav", kind="music", split="test", frames=60, sha256=checksum(folder / "one.wav"),
        source="", licence="", heard=((0, 8), (2, 52)), events={"beats": (0.4,), "stress": (0.8,)},
    )  # fmt: skip
    return save_sounds(folder, [one], {})


def test_each_sound_gets_its_codes_events_and_the_generators_own_motion(
    tiny_bundle: Path, tmp_path: Path, voice: np.ndarray
) -> None:
    """60 frames are 7 whole chunks: 140 audio frames, 14 motion tokens; frame 8 is motion token 2."""
    bundle = load_bundle(tiny_bundle)
    assert tokenize_sounds(sounds(tmp_path, voice), bundle.codec, bundle.generator, tmp_path / "tokens") == 1
    [path] = (tmp_path / "tokens").iterdir()
    clip = TokenClip.load(path)
    assert (clip.audio.shape, clip.motion.shape) == ((140, 2), (14, 3, 2))
    assert clip.domain.tolist() == [0, 0] + [2] * 12
    assert clip.split == "test"
    assert not clip.has_truth
    assert clip.cues is not None
    assert np.flatnonzero(clip.cues[:, 0]).tolist() == [30, 31, 32]
    assert np.flatnonzero(clip.cues[:, 1]).tolist() == [60, 61, 62]
    before = path.stat().st_mtime_ns
    tokenize_sounds(SoundSet(tmp_path), bundle.codec, bundle.generator, tmp_path / "tokens")
    assert path.stat().st_mtime_ns == before


def test_without_a_past_no_motion_is_made(
    tiny_bundle: Path, tmp_path: Path, voice: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle = load_bundle(tiny_bundle)
    monkeypatch.setattr("echoavatar_lab.models.tokenize.own_motion", None)
    tokenize_sounds(sounds(tmp_path, voice), bundle.codec, bundle.generator, tmp_path / "tokens", has_past=False)
    [path] = (tmp_path / "tokens").iterdir()
    clip = TokenClip.load(path)
    assert (clip.audio.shape, clip.motion.shape, clip.has_truth) == ((140, 2), (14, 3, 2), False)
    assert not clip.motion.any()


def test_the_motion_is_what_a_live_stream_makes_and_follows_the_seed(tiny_bundle: Path) -> None:
    generator = load_bundle(tiny_bundle).generator
    audio = np.random.default_rng(0).integers(16, size=(87, 2)).astype(np.int16)
    moved = own_motion(generator, audio, seed=0)
    import torch

    offline = open_stream(generator)(torch.from_numpy(audio[None, :80].astype(np.int64)))[0]
    np.testing.assert_array_equal(moved, offline.numpy())
    assert not np.array_equal(moved, own_motion(generator, audio, seed=1))
