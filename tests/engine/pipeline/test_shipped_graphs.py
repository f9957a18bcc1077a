"""The graphs of the shipped bundle compute what its modules of torch compute."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from echoavatar.engine.pipeline import Pipeline, load_bundle

CHUNKS = 7
ONE = torch.ones(1, dtype=torch.bool)


@pytest.fixture(scope="module")
def pair() -> tuple[Pipeline, Pipeline]:
    bundle = load_bundle()
    assert set(bundle.steps) == {"codec", "tokenizer", "face"}
    return Pipeline(bundle), Pipeline(replace(bundle, steps={}))


def test_sound_codes_and_curves(pair: tuple[Pipeline, Pipeline], voice: np.ndarray) -> None:
    states, equal = [pipeline.init_state(1) for pipeline in pair], []
    for chunk in torch.from_numpy(voice[: CHUNKS * 6400]).split(6400):
        both = list(zip(pair, states, strict=True))
        heard, wanted = (pipeline.encode_audio(chunk[None], state, ONE) for pipeline, state in both)
        equal.append(heard == wanted)
        curves, right = (pipeline.face.step(chunk[None], state.face[0], ONE, state.seeds) for pipeline, state in both)
        torch.testing.assert_close(curves, right, atol=1e-4, rtol=0)
        assert curves.std() > 0.01
    assert torch.cat(equal).float().mean() >= 0.999


def test_features_of_the_same_codes(pair: tuple[Pipeline, Pipeline]) -> None:
    states, random = [pipeline.init_state(1) for pipeline in pair], torch.Generator().manual_seed(0)
    for _ in range(CHUNKS):
        codes = torch.randint(512, (1, 2, 3, 6), generator=random)
        with torch.inference_mode():
            made, wanted = (
                pipeline.decode(codes, state.decoder, ONE) for pipeline, state in zip(pair, states, strict=True)
            )
        torch.testing.assert_close(made, wanted, atol=1e-4, rtol=0)
        assert made.std() > 0.1
