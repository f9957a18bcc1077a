"""Sessions side by side in lanes: the same motion, to the bit, as each alone."""

from pathlib import Path

import numpy as np

from echoavatar.engine import Engine
from echoavatar.pipeline import Pipeline, load_bundle

CHUNKS = 12


def sound(seed: int) -> np.ndarray:
    return (0.1 * np.random.default_rng(seed).standard_normal(CHUNKS * 6_400)).astype(np.float32)


def test_neighbours_in_other_lanes_change_nothing(tiny_bundle: Path) -> None:
    """Five sessions that come and wait at odd moments, three lanes, one model."""
    pipeline = Pipeline(load_bundle(tiny_bundle))
    engine = Engine(pipeline, seats=5, lanes=3)
    sessions = [engine.open(seed=seed) for seed in range(5)]
    sounds = [sound(seed) for seed in range(5)]
    for chunk in range(CHUNKS):
        for seat, (session, whole) in enumerate(zip(sessions, sounds, strict=True)):
            if (chunk + seat) % 3:  # the others get theirs later, two at once
                session.push(
                    whole[: (chunk + 1) * 6_400][int(session.made + 24_000 * session.seconds_waiting) :]
                )
        engine.tick()
    for session, whole in zip(sessions, sounds, strict=True):
        session.push(whole[int(session.made + 24_000 * session.seconds_waiting) :])
    while engine.tick():
        pass
    for seed, (session, whole) in enumerate(zip(sessions, sounds, strict=True)):
        alone = Engine(pipeline, lanes=1).open(seed=seed)
        alone.push(whole)
        for made, witness in zip(session, alone, strict=True):
            assert np.array_equal(made.rotations, witness.rotations)
            assert np.array_equal(made.root, witness.root)
        assert session.made == alone.made == len(whole)
