from pathlib import Path

import numpy as np
from tests.models.generator.tiny import config

from echoavatar.engine.pipeline import load_bundle
from echoavatar_lab.corpora.rehearsal.corpus import Plan, make_clip
from echoavatar_lab.evaluation.reliance import reliance, reliance_table, token_clips
from echoavatar_lab.models.generator.recipe import GeneratorTraining
from echoavatar_lab.models.generator.train import GeneratorTask
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.training import Loop


def test_a_model_that_knows_nothing_loses_nothing_when_the_audio_is_exchanged(tiny_bundle: Path) -> None:
    bundle = load_bundle(tiny_bundle)
    clips = [make_clip(Plan(1.0, 44, Path("unused"), clip_seconds=16.0), index) for index in range(2)]
    tokens = token_clips(bundle, clips)
    scores = reliance(bundle.generator, tokens)
    assert abs(scores["nll_gain_all"]) < 0.1
    assert scores["nll_gain_all"] == scores["nll_shuffled_all"] - scores["nll_all"]
    assert abs(scores["timing_gain_all"]) < 0.1
    table = reliance_table({"a": bundle.generator, "b": bundle.generator}, tokens).splitlines()
    assert table[0].count("|") == table[1].count("|") == table[-1].count("|") == 10
    assert table[-1].startswith("| all |")


def test_timing_is_worth_something_to_a_model_that_moves_on_what_it_hears_now() -> None:
    """Motion that repeats its chunk's audio code is a surprise to the trained model where that audio comes late."""
    rng = np.random.default_rng(0)
    made = []
    for _ in range(12):
        key = rng.integers(8, size=16)
        motion = np.repeat(key, 2)[:, None, None] * np.ones((1, 3, 2), int)
        audio = np.repeat(key, 20)[:, None].repeat(2, 1)
        made.append(TokenClip(audio, motion, np.ones(32, np.uint8)))
    settings = GeneratorTraining(steps=60, batch=8, chunks=4, learning_rate=5e-3, warmup=5, depth_weights=(1.0, 0.5))
    loop = Loop(GeneratorTask(config(layers=1), settings, made))
    for _ in range(60):
        loop.advance()
    assert reliance(loop.stage.generator.eval(), made)["timing_gain_speech"] > 0.3
