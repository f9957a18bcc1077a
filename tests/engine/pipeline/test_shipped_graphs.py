"""The graphs of the shipped bundle compute what its modules of torch compute."""

import numpy as np
import pytest

from echoavatar.engine import Engine, Session
from echoavatar.engine.pipeline import Pipeline, load_bundle

CHUNKS = 14
ONE = np.ones(1, np.bool_)


@pytest.fixture(scope="module")
def pair() -> tuple[Pipeline, Pipeline]:
    bundle = load_bundle()
    assert all(bundle.parts[part].graph for part in ("codec", "tokenizer", "face"))
    in_torch = bundle.having(codec=bundle.codec, tokenizer=bundle.tokenizer, face=bundle.face)
    return Pipeline(bundle), Pipeline(in_torch)


def test_sound_codes_and_curves(pair: tuple[Pipeline, Pipeline], voice: np.ndarray) -> None:
    states, equal = [pipeline.init_state(1) for pipeline in pair], []
    for chunk in np.split(voice[: CHUNKS * pair[0].chunk.samples], CHUNKS):
        both = list(zip(pair, states, strict=True))
        heard, wanted = (pipeline.encode_audio(chunk[None], state, ONE) for pipeline, state in both)
        equal.append(heard == wanted)
        curves, right = (pipeline.face.step(chunk[None], state.face[0], ONE, state.seeds) for pipeline, state in both)
        np.testing.assert_allclose(curves, right, atol=1e-4)
        assert curves.std() > 0.01
    assert np.concatenate(equal).mean() >= 0.999


def test_features_of_the_same_codes(pair: tuple[Pipeline, Pipeline]) -> None:
    states, random = [pipeline.init_state(1) for pipeline in pair], np.random.default_rng(0)
    for _ in range(CHUNKS):
        codes = random.integers(512, size=(1, pair[0].chunk.tokens, 3, 6))
        made, wanted = (
            pipeline.decoder.step(codes, state.decoder, ONE) for pipeline, state in zip(pair, states, strict=True)
        )
        np.testing.assert_allclose(made, wanted, atol=1e-4)
        assert made.std() > 0.1


def test_sessions_in_a_batch_move_as_each_alone(pair: tuple[Pipeline, Pipeline], voice: np.ndarray) -> None:
    """To the bit, so that no code is ever drawn otherwise because of a neighbour."""
    pipeline = pair[0]
    size = pipeline.chunk.samples
    sounds = [voice[start : start + 3 * size] for start in (0, 9_000, 28_000)]
    assert pipeline.rows_are_apart
    assert not pair[1].rows_are_apart
    engine = Engine(pipeline, seats=3, workers=1)
    together = [engine.open(seed=seed) for seed in range(3)]
    for session, sound in zip(together, sounds, strict=True):
        session.push(sound)
    together[1].act("wave")
    for chunk in range(1, 4):
        assert engine.work()
        assert {session.core.made for session in together} == {size * chunk}
    for seed, (session, sound) in enumerate(zip(together, sounds, strict=True)):
        alone = Engine(pipeline, workers=1).open(seed=seed)
        alone.push(sound)
        if seed == 1:
            alone.act("wave")
        assert _bits(session) == _bits(alone)


def _bits(session: Session) -> list[bytes]:
    return [part.tobytes() for chunk in session for part in (chunk.rotations, chunk.root, chunk.face)]
