from dataclasses import replace

import numpy as np

from echoavatar_lab.corpora.controls import neutral
from echoavatar_lab.corpora.dance.bends import SIZE_BY_RULE, SIZE_CAPTURED, with_bends
from echoavatar_lab.corpora.dance.grooves import GROOVES, Counts


def counts(energy: float) -> Counts:
    times = np.arange(1.0, 19.0, 0.5)
    return Counts(times, 4, GROOVES["pop"], ((0, len(times), energy),), 1.0, 19.0)


def bow(energy: float, pitch: float = 0.0):
    body = neutral(600)
    body = replace(body, spine=body.spine + np.array([0, pitch, 0], np.float32))
    bent = with_bends(body, counts(energy), np.random.default_rng(1), SIZE_BY_RULE)
    np.testing.assert_array_equal(bent.foot_position, body.foot_position)
    return bent.spine[:, 1] - body.spine[:, 1], bent


def test_louder_music_bends_the_body_deeper_and_lower():
    loud, body = bow(1.0)
    soft, _ = bow(0.0)
    assert loud.std() > 1.5 * soft.std() > 0.02
    assert body.pelvis_position[loud.argmax(), 1] < body.pelvis_position[0, 1] - 0.02
    assert body.pelvis_position[loud.argmax(), 2] < body.pelvis_position[0, 2] - 0.03


def test_bends_begin_and_end_with_the_music_and_rest_on_counts():
    pitch, _ = bow(1.0)
    assert not pitch[:30].any()
    assert np.abs(pitch[-6:]).max() < 1e-4
    speed = np.abs(np.gradient(pitch))
    on_counts = np.round((np.arange(4, 17, 1.0) + 0.06) * 30).astype(int)
    assert speed[on_counts].mean() < 0.2 * speed[on_counts - 15].mean()


def test_a_body_that_bends_already_bends_no_further():
    assert np.abs(bow(1.0, pitch=1.0)[0]).max() < 1e-3


def test_most_captured_dancers_are_bent_less_and_some_as_far():
    body = neutral(600)

    def deepest(size):
        made = [with_bends(body, counts(0.8), np.random.default_rng(seed), size).spine[:, 1] for seed in range(40)]
        return np.abs(np.array(made) - body.spine[:, 1]).max(1)

    by_rule, captured = deepest(SIZE_BY_RULE), deepest(SIZE_CAPTURED)
    assert np.median(captured) < 0.5 * np.median(by_rule)
    assert captured.max() > 0.8 * by_rule.max()
