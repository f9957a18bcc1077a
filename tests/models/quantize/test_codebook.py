import numpy as np
import pytest
import torch
from tests import golden as fixtures

from echoavatar.models.quantize import Codebook


def test_initialisation_and_one_ema_step_match_the_release():
    """tok_ema_step: first batch initialises, the second moves every code by 1 % of what it stood for."""
    golden = {
        name: torch.from_numpy(value)
        for name, value in np.load(fixtures.golden("reference_release/tok_ema_step.npz")).items()
    }
    book = Codebook(codes=8, width=4)
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
        book = Codebook(codes=4, width=2, dead_below=0.5)
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
    book = Codebook(codes=24, width=2, kmeans_steps=10)
    book.initialise(vectors, generator)
    assert book.squared_distances(vectors).min(-1).values.max() < 0.5


def test_a_small_first_batch_is_repeated_with_a_little_noise():
    book = Codebook(codes=10, width=4)
    book.initialise(torch.ones(3, 4), torch.Generator().manual_seed(1))
    assert len(book.codebook.unique(dim=0)) == 10
    assert (book.codebook - 1).abs().max() < 0.05


def test_gumbel_choice_follows_the_softmax_of_distances():
    """Codes at squared distances 0 and 0.5, temperature 0.5: odds e^0 : e^-1, that is 73 %."""
    book = Codebook(codes=2, width=1)
    book.initialise(torch.tensor([[0.0], [0.5**0.5]]))
    drawn = book.nearest(torch.zeros(20_000, 1), temperature=0.5, generator=torch.Generator().manual_seed(0))
    assert (drawn == 0).float().mean() == pytest.approx(0.731, abs=0.015)


def test_a_code_of_minus_one_is_the_zero_vector():
    book = Codebook(codes=2, width=3)
    book.initialise(torch.ones(2, 3))
    assert torch.equal(book.lookup(torch.tensor([0, -1])), torch.tensor([[1.0, 1, 1], [0, 0, 0]]))


def test_a_loaded_codebook_is_not_initialised_again():
    source, target = Codebook(codes=4, width=2), Codebook(codes=4, width=2)
    source.initialise(torch.randn(4, 2))
    assert not target.ready
    target.load_state_dict(source.state_dict())
    assert target.ready
    assert torch.equal(target.sums, source.codebook)
