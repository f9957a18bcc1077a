"""Noise is keyed, uniform and independent; draws follow the distribution they should."""

import torch

from echoavatar_lab.models.generator.sampling import gumbel_noise, make_sampler, mix, nucleus, uniform_noise


def noise(seed, start, count=4, codes=512):
    return uniform_noise(torch.tensor([seed]), torch.tensor([start]), count=count, codes=codes)[0]


def test_mix_is_splitmix64():
    """The published first output for seed 0 is 0xE220A8397B1DCDAF: the finaliser of one golden step."""
    first = mix(torch.tensor(0x9E3779B97F4A7C15 - 2**64))
    assert int(first) % 2**64 == 0xE220A8397B1DCDAF


def test_noise_depends_on_seed_and_absolute_position_alone():
    assert torch.equal(noise(5, 0, count=8)[3:], noise(5, 3, count=5))
    assert not torch.equal(noise(5, 0), noise(6, 0))
    both = uniform_noise(torch.tensor([9, 5]), torch.tensor([77, 3]), count=5, codes=512)
    assert torch.equal(both[1], noise(5, 3, count=5))


def test_noise_is_uniform_and_seeds_are_unrelated():
    """100,000 numbers: mean within 4 sigma of 1/2, tenths of 10,000, correlation of 0."""
    one, two = (noise(seed, 0, count=200, codes=500).flatten() for seed in (1, 2))
    assert abs(one.mean() - 0.5) < 4 * 0.2887 / 1e5**0.5
    assert float(one.min()) > 0
    assert float(one.max()) < 1
    tenths = torch.histc(one.float(), 10, 0, 1)
    assert bool(((tenths - 10_000).abs() < 4 * (10_000 * 0.9) ** 0.5).all())
    assert abs(torch.corrcoef(torch.stack([one, two]))[0, 1]) < 4 / 1e5**0.5
    assert abs(torch.corrcoef(torch.stack([one[1:], one[:-1]]))[0, 1]) < 4 / 1e5**0.5


def draws(logits, count=20_000, temperature=1.0, top_p=1.0):
    rows = len(logits)
    gumbel = -torch.log(-torch.log(noise(3, 0, count=count, codes=rows))).float()
    sampler = make_sampler(gumbel[:, None], torch.full((count,), temperature), torch.full((count,), top_p))
    drawn = sampler.draw(logits.expand(count, -1), 0)
    return torch.bincount(drawn, minlength=rows) / count


def test_draws_follow_the_softmax_at_the_temperature():
    logits = torch.tensor([0.1, 0.2, 0.7]).log()
    torch.testing.assert_close(draws(logits), torch.tensor([0.1, 0.2, 0.7]), atol=0.015, rtol=0)
    squared = torch.tensor([0.01, 0.04, 0.49])
    torch.testing.assert_close(draws(logits, temperature=0.5), squared / squared.sum(), atol=0.015, rtol=0)
    assert draws(logits, temperature=0.0).tolist() == [0, 0, 1]


def test_the_nucleus_keeps_the_fewest_codes_that_reach_its_mass():
    logits = torch.tensor([[0.1, 0.2, 0.7], [0.1, 0.2, 0.7], [0.1, 0.2, 0.7]]).log()
    kept = nucleus(logits, torch.tensor([0.6, 0.8, 1.0])).isfinite()
    assert kept.tolist() == [[False, False, True], [False, True, True], [True, True, True]]
    torch.testing.assert_close(draws(logits[0], top_p=0.8), torch.tensor([0, 2 / 9, 7 / 9]), atol=0.015, rtol=0)


def test_finer_layers_are_drawn_cooler() -> None:
    """Logits 0 and 1 at temperature 1 and cooling 0.5: layer 0 takes the likelier with 0.731, layer 1 with 0.881."""
    rows = 4000
    noise = gumbel_noise(torch.arange(rows), torch.zeros(rows, dtype=torch.int64), count=2, codes=2)
    one = torch.ones(rows)
    sampler = make_sampler(noise, one, one, layers=2, cooling=0.5)
    logits = torch.tensor([[0.0, 1.0]]).expand(rows, 2)
    coarse, fine = (sampler.draw(logits, position).float().mean() for position in (0, 1))
    assert abs(coarse - 0.731) < 0.03
    assert abs(fine - 0.881) < 0.03
