import copy
from pathlib import Path

import pytest
import torch
from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import clips

from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import CheckpointError
from echoavatar_lab.align.compare import as_markdown, compare, gain, over_seeds
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.align.rewards import RewardMix
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
from echoavatar_lab.models.generator.model import Generator


def test_a_gain_is_taken_prompt_by_prompt():
    """Prompts differ by 10, the policy by 1 and 3: 2, give or take 1."""
    assert gain({"by_prompt": [0.0, 10.0]}, {"by_prompt": [1.0, 13.0]}) == pytest.approx((2.0, 1.0))


def run(by_prompt, **more):
    reward = sum(by_prompt) / len(by_prompt)
    plain = {"kl": 0.1, "fid": 5.0, "diversity": 8.0, "stress_alignment": (0.2, 0.1)}
    return {"reward": (reward, 0.5), "rewards": {"a": (reward, 0.5)}, "by_prompt": by_prompt} | plain | more


BEGUN = run([0.0, 1.0, 2.0])
RUNS = [run([1.0, 2.0, 4.0], kl=0.2), run([1.0, 2.0, 2.0], fid=7.0)]


def test_spread_is_between_runs_and_error_over_prompts_of_their_mean():
    told = over_seeds(BEGUN, RUNS)
    assert told["runs"] == 2
    # means 7/3 and 5/3; by prompt 1, 2, 3, and 1, 1, 1 more than before
    assert told["reward"] == pytest.approx((2.0, (2 / 3) / 2**0.5, 1 / 3**0.5), abs=1e-5)
    assert told["gain"] == pytest.approx((1.0, (2 / 3) / 2**0.5, 0.0), abs=1e-5)
    assert told["kl"] == pytest.approx((0.15, 0.1 / 2**0.5), abs=1e-5)
    assert told["fid"] == pytest.approx((6.0, 2.0 / 2**0.5), abs=1e-5)
    assert told["stress_alignment"] == pytest.approx((0.2, 0.0))
    assert "beat_alignment" not in told  # no run met a beat
    assert over_seeds(BEGUN, RUNS[:1])["gain"] == pytest.approx((4 / 3, 0.0, 1 / 3), abs=1e-5)


def test_the_table_has_a_line_for_the_truth_the_untuned_and_every_method():
    truth = {name: value for name, value in BEGUN.items() if name not in ("kl", "by_prompt")}
    rows = as_markdown({"truth": truth, "untuned": BEGUN}, {"two": over_seeds(BEGUN, RUNS)}).splitlines()
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert {len(row) for row in cells} == {8}
    assert cells[0] == [
        "", "reward", "gain", "a", "KL, nats a code", "FID", "diversity, m", "stresses over chance"
    ]  # fmt: skip
    assert cells[2] == ["true motion", "1.00 +- 0.50", "", "1.00", "", "5.0", "8.00", "0.20 +- 0.10"]
    assert cells[3][:4] == ["untuned", "1.00 +- 0.50", "", "1.00"]
    assert cells[4][:4] == ["two", "2.00 +- 0.58 (0.47)", "+1.00 +- 0.00 (0.47)", "2.00 (0.47)"]
    assert cells[4][4:] == ["0.150 (0.071)", "6.0 (1.4)", "8.00 (0.00)", "0.20 (0.00)"]


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
