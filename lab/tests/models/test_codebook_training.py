"""The steadiest codes against every way there is, and against what the price promises."""

import itertools

import numpy as np
import pytest
import torch
from tests import golden as fixtures

from echoavatar_lab.models.codebook_training import (
    LearningCodebook,
    LearningQuantizer,
    Share,
    _steady_layers,
    steadiest,
)


def test_initialisation_and_one_ema_step_match_the_release():
    """tok_ema_step: first batch initialises, the second moves every code by 1 % of what it stood for."""
    golden = {
        name: torch.from_numpy(value)
        for name, value in np.load(fixtures.golden("reference_release/tok_ema_step.npz")).items()
    }
    book = LearningCodebook(codes=8, width=4)
    book.initialise(golden["x_init"].transpose(1, 2).reshape(-1, 4))
    torch.testing.assert_close(book.codebook, golden["codebook_after_init"], atol=1e-6, rtol=0)
    torch.testing.assert_close(book.counts, golden["count_after_init"], atol=1e-6, rtol=0)
    vectors = golden["x_step"].transpose(1, 2).reshape(-1, 4)
    codes = book.nearest(vectors)
    assert torch.equal(codes, golden["idx"])
    book.update(vectors, codes)
    torch.testing.assert_close(book.codebook, golden["codebook_after_step"], atol=1e-6, rtol=0)
    torch.testing.assert_close(book.sums, golden["code_sum"], atol=1e-6, rtol=0)
    torch.testing.assert_close(book.counts, golden["code_count"], atol=1e-6, rtol=0)


def test_dead_codes_are_revived_from_the_batch_and_alike_for_one_seed():
    """Two far codes are never chosen: they fall from 1 to under 0.5 in 69 steps (0.99^69 < 0.5)."""
    books = []
    for _ in range(2):
        book = LearningCodebook(codes=4, width=2, dead_below=0.5)
        book.initialise(torch.tensor([[0.0, 0.0], [1.0, 1.0], [90.0, 90.0], [-90.0, 90.0]]))
        generator = torch.Generator().manual_seed(3)
        vectors = torch.rand(32, 2, generator=generator)
        revived = [int(book.update(vectors, book.nearest(vectors), generator).sum()) for _ in range(69)]
        assert sum(revived[:68]) == 0
        assert sum(revived) == 2
        assert any(torch.allclose(book.codebook[2], vector) for vector in vectors)
        books.append(book.codebook)
    assert torch.equal(books[0], books[1])


def test_kmeans_start_finds_the_clusters():
    generator = torch.Generator().manual_seed(0)
    centres = torch.tensor([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    vectors = (centres[:, None] + 0.1 * torch.randn(4, 50, 2, generator=generator)).reshape(-1, 2)
    book = LearningCodebook(codes=24, width=2, kmeans_steps=10)
    book.initialise(vectors, generator)
    assert book.squared_distances(vectors).min(-1).values.max() < 0.5


def test_a_small_first_batch_is_repeated_with_a_little_noise():
    book = LearningCodebook(codes=10, width=4)
    book.initialise(torch.ones(3, 4), torch.Generator().manual_seed(1))
    assert len(book.codebook.unique(dim=0)) == 10
    assert (book.codebook - 1).abs().max() < 0.05


def test_gumbel_choice_follows_the_softmax_of_distances():
    """Codes at squared distances 0 and 0.5, temperature 0.5: odds e^0 : e^-1, that is 73 %."""
    book = LearningCodebook(codes=2, width=1)
    book.initialise(torch.tensor([[0.0], [0.5**0.5]]))
    drawn = book.nearest(torch.zeros(20_000, 1), temperature=0.5, generator=torch.Generator().manual_seed(0))
    assert (drawn == 0).float().mean() == pytest.approx(0.731, abs=0.015)


def test_a_loaded_codebook_is_not_initialised_again():
    source, target = LearningCodebook(codes=4, width=2), LearningCodebook(codes=4, width=2)
    source.initialise(torch.randn(4, 2))
    assert not target.ready
    target.load_state_dict(source.state_dict())
    assert target.ready
    assert torch.equal(target.sums, source.codebook)


def cost(distances, price, path):
    changes = sum(a != b for a, b in itertools.pairwise(path))
    return sum(float(distances[t, k]) for t, k in enumerate(path)) + price * changes


@pytest.mark.parametrize("seed", range(6))
def test_no_way_through_is_cheaper(seed):
    """All 3^6 ways through six steps of three codes."""
    distances = torch.rand(6, 3, generator=torch.Generator().manual_seed(seed))
    for price in (0.05, 0.3, 1.0):
        best = min(cost(distances, price, way) for way in itertools.product(range(3), repeat=6))
        assert cost(distances, price, steadiest(distances, price).tolist()) == pytest.approx(best)


def test_no_price_takes_the_nearest_and_a_high_one_a_single_code():
    distances = torch.rand(40, 8, generator=torch.Generator().manual_seed(0))
    assert torch.equal(steadiest(distances, 0.0), distances.argmin(1))
    single = steadiest(distances, 1e6)
    assert single.unique().tolist() == [int(distances.sum(0).argmin())]


def test_one_step_is_the_nearest():
    assert steadiest(torch.tensor([[3.0, 1.0, 2.0]]), 5.0).tolist() == [1]


def trained(layers=3, seed=0, steps=5, **options):
    generator = torch.Generator().manual_seed(seed)
    quantizer = LearningQuantizer(codes=16, width=8, layers=layers, **options).train()
    for _ in range(steps):
        learn(quantizer, torch.randn(4, 20, 8, generator=generator), generator)
    return quantizer, generator


def learn(quantizer, batch, generator=None):
    """A step as tasks take it."""
    if not quantizer.is_ready:
        quantizer.initialise(batch.flatten(0, 1), generator)
    quantizer(batch, generator=generator, share=Share(0, len(batch)))
    quantizer.settle(lambda rows: rows, generator)


def test_each_layer_reduces_what_is_left_over():
    quantizer, generator = trained(steps=40)
    x = torch.randn(2, 30, 8, generator=generator)
    codes = quantizer.eval().encode(x)
    errors = [float((quantizer.decode(codes[..., :q]) - x).square().mean()) for q in (1, 2, 3)]
    assert errors[0] > errors[1] > errors[2]
    assert codes.shape == (2, 30, 3)


def test_patience_changes_codes_less_often_and_costs_little():
    """A slow walk with a tremble: the nearest codes flip, the patient ones wait for the walk; each row by itself."""
    quantizer, generator = trained(steps=40)
    quantizer.eval()
    walk = torch.randn(2, 60, 8, generator=generator).cumsum(1) * 0.15
    x = walk + 0.1 * torch.randn(2, 60, 8, generator=generator)
    plain, patient = quantizer.encode(x), _steady_layers(quantizer, x, 0.5)

    def changes(codes):
        return int((codes[:, 1:] != codes[:, :-1]).sum())

    def missed(codes):
        return float((quantizer.decode(codes) - x).square().mean())

    assert changes(patient) < 0.7 * changes(plain)
    assert missed(patient) < 1.6 * missed(plain)
    assert torch.equal(patient[1:], _steady_layers(quantizer, x[1:], 0.5))


def test_the_gradient_passes_straight_through_once():
    """d(sum of outputs)/d(input) is one everywhere, whatever the number of layers."""
    quantizer, generator = trained()
    x = torch.randn(2, 5, 8, generator=generator, requires_grad=True)
    quantizer.eval()(x).latents.sum().backward()
    assert torch.allclose(x.grad, torch.ones_like(x))


def test_encode_and_forward_choose_alike_in_eval_mode_and_learn_nothing():
    quantizer, generator = trained()
    quantizer.eval()
    before = quantizer.layers[0].codebook.clone()
    x = torch.randn(2, 5, 8, generator=generator)
    result = quantizer(x, temperature=0.5, dropout=1.0)
    assert torch.equal(result.codes, quantizer.encode(x))
    torch.testing.assert_close(result.latents.detach(), quantizer.decode(result.codes), atol=1e-6, rtol=1e-5)
    assert torch.equal(before, quantizer.layers[0].codebook)


def test_commitment_is_the_mean_distance_of_the_layers_used():
    quantizer, generator = trained(layers=2)
    x = torch.randn(1, 6, 8, generator=generator)
    result = quantizer.eval()(x)
    first = quantizer.decode(result.codes[..., :1])
    expected = ((x - first).square().mean() + (x - quantizer.decode(result.codes)).square().mean()) / 2
    torch.testing.assert_close(result.commitment, expected)


def test_dropout_skips_trailing_layers_and_is_repeatable():
    runs = []
    for _ in range(2):
        quantizer, generator = trained(seed=5)
        kept = [
            quantizer(torch.randn(1, 4, 8, generator=generator), dropout=0.9, generator=generator).codes[0, 0]
            for _ in range(30)
        ]
        runs.append([int((codes >= 0).sum()) for codes in kept])
    assert runs[0] == runs[1]
    assert set(runs[0]) == {1, 2, 3}


def test_resuming_from_the_saved_averages_continues_the_same_run():
    batches = torch.randn(6, 4, 20, 8, generator=torch.Generator().manual_seed(9))
    whole, _ = trained(steps=0)
    for batch in batches:
        learn(whole, batch)
    first, _ = trained(steps=0)
    for batch in batches[:3]:
        learn(first, batch)
    second = LearningQuantizer(codes=16, width=8, layers=3).train()
    second.load_state_dict(first.state_dict())
    for name, value in second.training_state().items():
        value.copy_(first.training_state()[name])
    for batch in batches[3:]:
        learn(second, batch)
    for mine, theirs in zip(second.books(), whole.books(), strict=True):
        assert torch.equal(mine.codebook, theirs.codebook)
        assert torch.equal(mine.counts, theirs.counts)


def test_codebooks_taken_from_many_latents_halve_the_error_layer_by_layer():
    generator = torch.Generator().manual_seed(0)
    latents = torch.randn(400, 8, generator=generator)
    quantizer = LearningQuantizer(codes=64, width=8, layers=3, kmeans_steps=5)
    quantizer.initialise(latents, generator)
    codes = quantizer.encode(latents[None])
    errors = [float((quantizer.decode(codes[..., :q]) - latents).square().mean()) for q in (1, 2, 3)]
    assert errors[0] < 0.6
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.6 * errors[1]
