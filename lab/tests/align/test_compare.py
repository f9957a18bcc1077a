"""Generators side by side: the same one gains nothing and costs nothing, another vocabulary is refused."""

import copy
from pathlib import Path

import pytest
import torch
from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import clips

from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import CheckpointError
from echoavatar.models.generator import Generator
from echoavatar_lab.align.compare import compare
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.align.rewards import RewardMix
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped


@pytest.fixture
def parts(tiny_bundle: Path):
    bundle = load_bundle(tiny_bundle)
    prompts = PromptSampler(clips(3, chunks=8), past=2, length=4).spread(3)
    mix = RewardMix({"smoothness": 1.0}, reference_statistics())
    return bundle, prompts, mix


def test_the_same_generator_gains_nothing_and_another_diverges(parts):
    bundle, prompts, mix = parts
    other = Generator(bundle.generator.config)
    other.load_state_dict(bundle.generator.state_dict())
    with torch.no_grad():
        other.lm_head.weight.mul_(3.0)
    made = {"first": bundle.generator, "again": bundle.generator, "sharper": other}
    found = compare(made, bundle.tokenizer, prompts, mix, load_shipped(), group=2)
    assert list(found) == ["truth", "first", "again", "sharper"]
    assert found["truth"]["fid"] == pytest.approx(0, abs=1e-2)
    assert found["again"] == found["first"]
    assert found["again"]["gain"] == (0.0, 0.0)
    assert found["again"]["kl"] == pytest.approx(0, abs=1e-6)
    assert found["sharper"]["kl"] > 1e-3
    gained = found["sharper"]["reward"][0] - found["first"]["reward"][0]
    assert found["sharper"]["gain"][0] == pytest.approx(gained, abs=1e-4)


def test_generators_move_to_the_device(parts, monkeypatch):
    """Nothing can be drawn on a device without memory, so the probe only looks where the weights are."""
    bundle, prompts, mix = parts
    seen = []

    def looks(*args, **kwargs):
        def probe(policy, reference):
            seen.append({next(one.generator.parameters()).device.type for one in (policy, reference)})
            return {"by_prompt": [0.0, 0.0, 0.0], "seconds": 0.0}

        return probe

    monkeypatch.setattr("echoavatar_lab.align.compare.Probe", looks)
    made = {"first": bundle.generator, "second": copy.deepcopy(bundle.generator)}
    compare(made, bundle.tokenizer, prompts, mix, load_shipped(), group=2, device="meta")
    assert seen == [{"meta"}, {"meta"}]


def test_another_vocabulary_is_refused(parts):
    bundle, prompts, mix = parts
    layout = bundle.generator.config.layout.model_copy(update={"audio_codes": 7})
    foreign = Generator(bundle.generator.config.model_copy(update={"layout": layout}))
    with pytest.raises(CheckpointError, match="another vocabulary"):
        compare({"a": bundle.generator, "b": foreign}, bundle.tokenizer, prompts, mix, load_shipped(), group=2)
