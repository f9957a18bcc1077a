"""A whole file through a generator that hears ahead."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar.engine import animate_many
from echoavatar.engine.pipeline import Bundle, Pipeline, load_bundle
from echoavatar.models.audio import AudioCodec
from echoavatar.models.generator import Generator
from echoavatar_lab.tables.lookahead import LookaheadPipeline

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
    return replace(bundle, generator=generator.eval())


def heard(bundle: Bundle, sound: np.ndarray) -> list[torch.Tensor]:
    """What the generator is told, chunk by chunk."""
    pipeline, told = LookaheadPipeline(bundle, {SEED: sound}), []
    state = pipeline.init_state(1)
    pipeline.reset(state, torch.ones(1, dtype=torch.bool), seed=SEED)
    for _ in range(-(-len(sound) // 6400)):
        told.append(pipeline.encode_audio(torch.zeros(1, 6400), state, torch.ones(1, dtype=torch.bool)))
    return told


def test_the_generator_is_told_codes_of_later_and_silence_behind_the_end(bundle: Bundle, voice: np.ndarray) -> None:
    now, later = (heard(early(bundle, chunks), voice) for chunks in (0, 2))
    assert all(torch.equal(a, b) for a, b in zip(now[2:7], later[:5], strict=True))
    assert not any(torch.equal(a, b) for a, b in zip(now[:5], now[2:7], strict=True))
    assert len(later) == len(now) == 8
    assert not torch.equal(later[-1], now[-1])


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
