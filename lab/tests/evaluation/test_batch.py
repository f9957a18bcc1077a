from pathlib import Path

import numpy as np
import pytest
from tests.models.face.tiny import make

from echoavatar.engine import animate
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import AudioError
from echoavatar_lab.evaluation.batch import animate_many


def test_many_at_once_are_as_one_by_one(tiny_bundle: Path, voice: np.ndarray) -> None:
    """Sounds of different lengths end at different ticks; the others go on. Their faces come with them."""
    bundle = load_bundle(tiny_bundle).having(face=make().float())
    pipeline = Pipeline(bundle, precision="float32")
    sounds = [voice, voice[:9_000] * 0.3, voice[5_000:]]
    told: list[tuple[int, int]] = []
    shown = animate_many(pipeline, sounds, seeds=[4, 5, 6], progress=lambda *at: told.append(at))
    assert told[-1] == (8 + 2 + 7, 8 + 2 + 7)
    for (motion, audio, seconds, face), sound, seed in zip(shown, sounds, [4, 5, 6], strict=True):
        alone = animate(pipeline, [sound], seed=seed)
        np.testing.assert_allclose(motion.rotations, alone.motion.rotations, atol=1e-5)
        np.testing.assert_allclose(motion.root, alone.motion.root, atol=1e-5)
        np.testing.assert_array_equal(audio, alone.audio)
        assert seconds > 0
        assert face is not None
        assert alone.face is not None
        assert face.shape == (motion.frames, 52)
        np.testing.assert_allclose(face, alone.face, atol=1e-4)


def test_a_sound_without_samples_among_many_is_named(tiny_bundle: Path, voice: np.ndarray) -> None:
    pipeline = Pipeline(load_bundle(tiny_bundle))
    with pytest.raises(AudioError, match="number 1"):
        animate_many(pipeline, [voice, voice[:0]], seeds=[0, 1])
