"""Sound alone becomes prompts that say they are no truth."""

from pathlib import Path

import numpy as np

from echoavatar.engine.pipeline import load_bundle
from echoavatar.models.audio.io import write_wav
from echoavatar.models.generator import open_stream
from echoavatar_lab.data import Sound, SoundSet
from echoavatar_lab.data.corpus import checksum
from echoavatar_lab.data.sounds import save_sounds
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenize_sound import own_motion, tokenize_sounds


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


def test_the_motion_is_what_a_live_stream_makes_and_follows_the_seed(tiny_bundle: Path) -> None:
    generator = load_bundle(tiny_bundle).generator
    audio = np.random.default_rng(0).integers(16, size=(87, 2)).astype(np.int16)
    moved = own_motion(generator, audio, seed=0)
    import torch

    offline = open_stream(generator)(torch.from_numpy(audio[None, :80].astype(np.int64)))[0]
    np.testing.assert_array_equal(moved, offline.numpy())
    assert not np.array_equal(moved, own_motion(generator, audio, seed=1))
