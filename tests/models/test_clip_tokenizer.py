"""Whole clips by steps, and the shipped graphs beside the lab's module."""

from typing import NamedTuple

import numpy as np
import pytest

from echoavatar.engine.pipeline import load_bundle
from echoavatar.models.clip_tokenizer import ClipTokenizer
from echoavatar.motion.kinematics import HUMANOID, to_features
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS, clip


class Sum(NamedTuple):
    """A step that takes `each` frames and tells, for every `per`, the sum of all that it heard."""

    each: int
    per: int

    def init_state(self, rows: int) -> np.ndarray:
        return np.zeros((rows, 1))

    def step(self, x: np.ndarray, state: np.ndarray, active: np.ndarray) -> np.ndarray:
        assert x.shape[:2] == (1, self.each)
        assert active.all()
        made = state[:, None] + np.cumsum(x, 1)[:, self.per - 1 :: self.per]
        state += x.sum(1)
        return made


@pytest.fixture(scope="module")
def shipped() -> ClipTokenizer:
    bundle = load_bundle()
    return bundle.parts["tokenizer"].clip_tokenizer(bundle.chunk)


def test_the_past_goes_from_step_to_step_and_what_fills_the_last_is_cut_off(shipped: ClipTokenizer) -> None:
    tokenizer = ClipTokenizer(shipped.config, Sum(12, 4), Sum(3, 1), tokens=3)
    assert tokenizer.encode(np.ones((20, 1))).tolist() == [[4], [8], [12], [16], [20]]
    assert tokenizer.decode(np.ones((1, 1))).tolist() == [[1], [2], [3]]
    with pytest.raises(ValueError, match="21 frames are not a multiple of 4"):
        tokenizer.encode(np.ones((21, 1)))


@pytest.mark.parametrize("name", ["wave", "shrug"])
def test_codes_and_features_of_the_graphs_are_those_of_the_module(shipped: ClipTokenizer, name: str) -> None:
    module, moving = load_bundle().tokenizer.clips(), clip(SCRIPTS[name])
    frames = moving.frames // 4 * 4
    features = to_features(HUMANOID, moving.matrices()[:frames], moving.root[:frames])
    codes, wanted = shipped.encode(features), module.encode(features)
    assert codes.shape == wanted.shape == (frames // 4, 3, 6)
    assert (codes == wanted).mean() >= 0.999
    assert np.array_equal(codes[:, 1, 0], wanted[:, 1, 0]), "of which an action is made"
    codes[:, 0, 1:] = -1
    np.testing.assert_allclose(shipped.decode(codes), module.decode(codes), atol=1e-4)
