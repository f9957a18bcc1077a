"""A whole file through a generator that hears ahead."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.datasets.samples import write_beat2
from lab.tests.evaluation.clips import clip
from lab.tests.foreign.test_smpl import write_edge
from tests.motion.kinematics.samples import swaying

from echoavatar.engine.pipeline import Bundle, Pipeline, load_bundle
from echoavatar.errors import MotionError
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.formats.smpl import skeleton
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.foreign.smpl import read_smplx
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.tables.generate import LookaheadPipeline, decoded_motion, foreign_motion, live_motion


@pytest.mark.parametrize("ahead", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_live_motion_is_as_long_as_its_sound_whether_or_not_it_hears_ahead(
    tiny_bundle: Path, voice: np.ndarray, ahead: int
) -> None:
    bundle = load_bundle(tiny_bundle)
    generator = Generator(bundle.generator.config.model_copy(update={"ahead_chunks": ahead}))
    (made,) = live_motion("tiny", bundle.codec, bundle.tokenizer, generator, {5: voice})
    assert made.frames == 60
    assert np.isfinite(made.rotations).all()


def test_codes_of_the_papers_order_are_decoded_too(tiny_bundle: Path, voice: np.ndarray) -> None:
    bundle = load_bundle(tiny_bundle)
    generator = Generator(bundle.generator.config.model_copy(update={"sequence": "prefix"}))
    (made,) = decoded_motion(bundle.codec, bundle.tokenizer, generator, {0: voice})
    assert made.frames == 60


def test_decoded_motion_follows_its_own_seed_and_sound(tiny_bundle: Path, voice: np.ndarray) -> None:
    bundle = load_bundle(tiny_bundle)
    parts = (bundle.codec, bundle.tokenizer, bundle.generator)
    short = voice[: 800 * 21]
    told: list[tuple[int, int]] = []
    both = decoded_motion(*parts, {1: voice, 2: short}, progress=lambda done, of: told.append((done, of)))
    (alone,) = decoded_motion(*parts, {2: short})
    (other,) = decoded_motion(*parts, {3: short})
    assert [motion.frames for motion in both] == [60, 21]
    assert told == [(1, 2), (2, 2)]
    np.testing.assert_allclose(both[1].rotations, alone.rotations, atol=1e-6)
    assert not np.array_equal(other.rotations, alone.rotations)
    assert replace(both[1]).skeleton is both[0].skeleton


SEED = 3


@pytest.fixture
def bundle(tiny_bundle: Path, voice: np.ndarray) -> Bundle:
    """With code vectors that tell sounds apart: some of the codec's own latents."""
    bundle = load_bundle(tiny_bundle)
    codec, random = bundle.codec, torch.Generator().manual_seed(0)
    noise = 0.3 * torch.randn(1, 48_000, generator=random)
    with torch.no_grad():
        latents = torch.cat([latents_of(codec, x) for x in (torch.from_numpy(voice)[None], noise)])
        codec.codebooks[0] = latents[torch.randperm(len(latents), generator=random)[:16]]
    return bundle


def latents_of(codec: AudioCodec, sound: torch.Tensor) -> torch.Tensor:
    return codec.latents(sound, codec.init_state(1), torch.ones(1, dtype=torch.bool))[0]


def early(bundle: Bundle, chunks: int) -> Bundle:
    """The same weights, told the sound so many chunks before it is due."""
    generator = Generator(bundle.generator.config.model_copy(update={"ahead_chunks": chunks}))
    generator.load_state_dict(bundle.generator.state_dict())
    return bundle.having(generator=generator.eval())


def heard(bundle: Bundle, sound: np.ndarray) -> list[np.ndarray]:
    """What the generator is told, chunk by chunk."""
    pipeline, told = LookaheadPipeline(bundle, {SEED: sound}), []
    state = pipeline.init_state(1)
    pipeline.reset(state, np.ones(1, np.bool_), seed=SEED)
    for _ in range(-(-len(sound) // 6400)):
        told.append(pipeline.encode_audio(np.zeros((1, 6400), np.float32), state, np.ones(1, np.bool_)))
    return told


def test_the_generator_is_told_codes_of_later_and_silence_behind_the_end(bundle: Bundle, voice: np.ndarray) -> None:
    now, later = (heard(early(bundle, chunks), voice) for chunks in (0, 2))
    assert all(np.array_equal(a, b) for a, b in zip(now[2:7], later[:5], strict=True))
    assert not any(np.array_equal(a, b) for a, b in zip(now[:5], now[2:7], strict=True))
    assert len(later) == len(now) == 8
    assert not np.array_equal(later[-1], now[-1])


def test_without_ahead_it_moves_as_a_stream_does(bundle: Bundle, voice: np.ndarray) -> None:
    (live,) = animate_many(Pipeline(bundle), [voice], seeds=[SEED])
    (known,) = animate_many(LookaheadPipeline(bundle, {SEED: voice}), [voice], seeds=[SEED])
    np.testing.assert_allclose(known.motion.rotations, live.motion.rotations, atol=1e-5)


def test_two_sounds_of_different_length_keep_to_their_own(bundle: Bundle, voice: np.ndarray) -> None:
    """The short one ends first; the other is then alone in its step and still hears its own sound."""
    other = np.random.default_rng(0).normal(0, 0.2, 20_000).astype(np.float32)
    both = LookaheadPipeline(early(bundle, 1), {0: other, 1: voice})
    together = animate_many(both, [other, voice], seeds=[0, 1])
    (alone,) = animate_many(LookaheadPipeline(early(bundle, 1), {1: voice}), [voice], seeds=[1])
    np.testing.assert_allclose(together[1].motion.rotations, alone.motion.rotations, atol=1e-4)
    assert together[0].motion.frames == 25


def smplx(folder: Path, name: str, seconds: float = 3.0) -> Path:
    """Motion as EMAGE writes it: `res_NAME.npz` beside the true `gt_NAME.npz`."""
    path = write_beat2(folder / "source", name, seconds)
    made = folder / "made"
    made.mkdir(exist_ok=True)
    for kind in ("res", "gt"):
        (made / f"{kind}_{name}.npz").write_bytes(path.read_bytes())
    return made


def test_motion_as_emage_writes_it_stays_on_its_rig_or_comes_to_ours(tmp_path: Path) -> None:
    made = smplx(tmp_path, "2_scott_0_1_1")
    wanted = clip("2_scott_0_1_1", 90)
    own = foreign_motion(made, wanted, skeleton())
    np.testing.assert_allclose(own.rotations, read_smplx(made / "res_2_scott_0_1_1.npz").rotations, atol=1e-6)
    assert foreign_motion(made, wanted, HUMANOID).skeleton.names == HUMANOID.names


def test_motion_as_edge_writes_it_and_bvh_come_to_our_rig(tmp_path: Path) -> None:
    with np.load(write_beat2(tmp_path, "a", is_z_up=True)) as stored:
        write_edge(tmp_path / "test_a.pkl", stored["poses"][:, :72], stored["trans"])
    motion = swaying(90)
    write_bvh(tmp_path / "b.bvh", motion.skeleton, motion.rotations, motion.root, 30)
    for name in ("a", "b"):
        assert foreign_motion(tmp_path, clip(name, 90), HUMANOID).frames == 90


def test_what_does_not_fit_is_named(tmp_path: Path) -> None:
    made = smplx(tmp_path, "a")
    with pytest.raises(MotionError, match=r"made lacks the test clip b \(it holds 1 files, for example a\)"):
        foreign_motion(made, clip("b", 90), HUMANOID)
    with pytest.raises(MotionError, match=r"res_a\.npz has 90 frames, the test clip 200; make motion for the whole"):
        foreign_motion(made, clip("a", 200), HUMANOID)
    assert foreign_motion(made, clip("a", 150), HUMANOID).frames == 90  # EMAGE drops the end
    motion = swaying(90)
    write_bvh(tmp_path / "a.bvh", motion.skeleton, motion.rotations, motion.root, 30)
    with pytest.raises(MotionError, match=r"a\.bvh: it has 52 joints .* this table is on 55"):
        foreign_motion(tmp_path, clip("a", 90), skeleton())
    with np.load(made / "res_a.npz") as stored:
        arrays = dict(stored)
    arrays["trans"][4] = np.nan
    np.savez(made / "res_a.npz", **arrays)
    with pytest.raises(MotionError, match=r"res_a\.npz, frame 4: .*not finite; repair it"):
        foreign_motion(made, clip("a", 90), HUMANOID)
    arrays["trans"][4] = 0
    np.savez(made / "res_a.npz", **arrays | {"mocap_frame_rate": 60})
    with pytest.raises(MotionError, match=r"res_a\.npz is at 60 frames per second, .* --resample"):
        foreign_motion(made, clip("a", 45), HUMANOID)
    assert foreign_motion(made, clip("a", 45), HUMANOID, is_resampling=True).frames == 45
