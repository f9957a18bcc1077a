from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from echoavatar.engine.pipeline import load_bundle
from echoavatar.models.generator import Generator
from echoavatar_lab.tables.generate import decoded_motion, live_motion


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
