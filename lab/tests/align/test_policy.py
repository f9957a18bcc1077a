"""What is sampled is what is scored: temperature, cooling, nucleus, both orders of the sequence."""

import pytest
import torch
from tests.models.generator.tiny import audio, generator

from echoavatar.errors import CheckpointError
from echoavatar.models.generator import GeneratorConfig
from echoavatar_lab.align.policy import GeneratorPolicy, Sampling, check_reference, mean_by_layer, soup
from echoavatar_lab.align.prompts import PromptBatch
from echoavatar_lab.models.generator.sequences import compact_layout

WARM = Sampling(temperature=0.9, cooling=0.7, top_p=0.8)


def prompts(rows: int = 2, past: int = 2, length: int = 1) -> PromptBatch:
    random = torch.Generator().manual_seed(4)
    return PromptBatch(
        audio(rows, 20 * (past + length), random), torch.randint(8, (rows, 2 * past, 3, 2), generator=random)
    )


def seeds(count: int, seed: int = 0) -> torch.Tensor:
    return torch.randint(2**40, (count,), generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("sequence", ["interleaved", "prefix", "depth"])
def test_codes_are_drawn_as_often_as_their_scores_say(sequence):
    """Of 400 draws, the first code of the second time step's every segment: frequencies against probabilities.

    The expected count of a code is the sum of its scored probabilities over the rows (each row has its own past by
    then). The difference of a count from that has a spread below sqrt(400) / 2 = 10; five times it is the tolerance.
    """
    policy = GeneratorPolicy(generator(sequence=sequence), WARM)
    one = prompts(1)
    codes = policy.rollout(one, 400, seeds(400))
    parts = [policy.score(one.repeated(len(part)), part) for part in codes.split(200)]
    expected = torch.cat([part.all_log_probs.exp() for part in parts]).sum(0)
    flat = codes.flatten(2)
    counts = torch.nn.functional.one_hot(flat, 8).sum(0)
    assert (counts - expected).abs().max() < 50
    assert (expected[1] > 50).sum() > 12  # not all the same code: the comparison says something
    support = torch.cat([part.support for part in parts])
    natural = policy.score(one.repeated(200), codes[:200], uses_nucleus=False).all_log_probs.exp()
    kept = (natural * support[:200]).sum(-1)
    assert kept.min() > 0.8 - 1e-4  # the nucleus holds at least its mass ...
    assert support.float().mean() < 0.8  # ... and leaves codes out


def test_hot_and_plain_scores_differ_so_the_temperature_is_in_them():
    policy = GeneratorPolicy(generator(), WARM)
    codes = policy.rollout(prompts(), 2, seeds(4))
    warm = policy.score(prompts().repeated(2), codes).log_probs
    plain = GeneratorPolicy(generator(), Sampling()).score(prompts().repeated(2), codes).log_probs
    assert (warm - plain).abs().mean() > 0.1
    by_hand = GeneratorPolicy(generator(), Sampling()).score(prompts().repeated(2), codes).all_log_probs
    warmth = torch.tensor([0.9, 0.63]).repeat(3)[:, None]
    again = torch.log_softmax(by_hand / warmth, -1)
    uncut = policy.score(prompts().repeated(2), codes, uses_nucleus=False).all_log_probs
    torch.testing.assert_close(again, uncut, atol=1e-5, rtol=1e-5)


def test_a_support_that_is_given_is_kept_when_the_weights_move():
    policy = GeneratorPolicy(generator(), WARM)
    codes = policy.rollout(prompts(), 2, seeds(4))
    before = policy.score(prompts().repeated(2), codes)
    with torch.no_grad():
        policy.generator.lm_head.weight.mul_(1.5)
    after = policy.score(prompts().repeated(2), codes, before.support)
    assert torch.equal(after.support, before.support)
    assert after.log_probs.isfinite().all()
    torch.testing.assert_close(after.all_log_probs.exp().sum(-1), torch.ones(4, 2, 6))


@pytest.mark.parametrize("sequence", ["interleaved", "prefix", "depth"])
def test_a_continuation_does_not_depend_on_its_group(sequence):
    """Sharing the prompt's state between continuations is only thrift."""
    policy, many = GeneratorPolicy(generator(sequence=sequence), WARM), seeds(6)
    together = policy.rollout(prompts(2, length=2), 3, many)
    alone = [policy.rollout(prompts(2, length=2).rows(slice(k // 3, k // 3 + 1)), 1, many[k : k + 1]) for k in range(6)]
    assert torch.equal(together, torch.cat(alone))
    assert len({tuple(row.flatten().tolist()) for row in together}) > 3


def test_long_prompts_are_scored_through_the_sliding_window():
    """Likeliest codes at temperature 0 are those that the scores rank first, also when the window has slid."""
    for sequence in ("interleaved", "prefix"):
        policy = GeneratorPolicy(generator(sequence=sequence), Sampling(temperature=0))
        batch = prompts(2, past=3, length=4)
        codes = policy.rollout(batch, 1, seeds(2))
        plain = GeneratorPolicy(generator(sequence=sequence), Sampling())
        best = plain.score(batch, codes).all_log_probs.argmax(-1)
        assert torch.equal(best, codes.flatten(2))


def test_gradients_of_scores_agree_with_finite_differences():
    policy = GeneratorPolicy(generator().double(), WARM)
    batch = prompts(1)
    codes = torch.randint(8, (1, 2, 3, 2), generator=torch.Generator().manual_seed(1))
    scores = policy.score(batch, codes, uses_nucleus=False)
    weight = policy.generator.lm_head.weight
    scores.log_probs.sum().backward()
    row = policy.layout.segment_start(0) + int(codes[0, 0, 0, 0])
    got, step = weight.grad[row, 5].item(), 1e-3
    with torch.no_grad():
        values = []
        for sign in (1, -1):
            weight[row, 5] += sign * step
            values.append(policy.score(batch, codes, uses_nucleus=False).log_probs.double().sum().item())
            weight[row, 5] -= sign * step
    assert got == pytest.approx((values[0] - values[1]) / (2 * step), rel=2e-2)


def test_entropy_is_averaged_by_layer():
    values = torch.tensor([0.0, 1.0]).repeat(3).expand(2, 4, 6)
    assert mean_by_layer(values, 2) == [0.0, 1.0]


def test_a_reference_of_another_vocabulary_is_refused():
    own = generator()
    other = type(own)(
        GeneratorConfig(
            layout=compact_layout(audio_codes=16, motion_layers=2, motion_codes=16),
            width=32, heads=4, kv_heads=2, mlp=48, layers=2, window_chunks=3,
        )
    )  # fmt: skip
    with pytest.raises(CheckpointError, match="reference other has another vocabulary"):
        check_reference(own, other, name="other")
    check_reference(own, generator(seed=1), name="same")


def moved(start, by: float):
    model = type(start)(start.config)
    model.load_state_dict({name: value + by for name, value in start.state_dict().items()})
    return model


def test_shares_say_how_far_each_run_counts():
    start = generator()
    mixed = soup(start, {"a": (moved(start, 1.0), 0.5), "b": (moved(start, 2.0), 0.25)})
    for name, value in start.state_dict().items():
        torch.testing.assert_close(mixed.state_dict()[name], value + 1.0)
    whole = soup(start, {"a": (moved(start, 1.0), 1.0)})
    torch.testing.assert_close(whole.lm_head.weight, start.lm_head.weight + 1.0)


def test_another_order_is_refused():
    with pytest.raises(CheckpointError, match="run other has another sequence: prefix"):
        soup(generator(), {"other": (generator(sequence="prefix"), 1.0)})
