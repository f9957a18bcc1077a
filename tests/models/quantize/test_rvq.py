import torch

from echoavatar.models.quantize import ResidualVectorQuantizer


def trained(layers=3, seed=0, steps=5, **options):
    generator = torch.Generator().manual_seed(seed)
    quantizer = ResidualVectorQuantizer(codes=16, width=8, layers=layers, **options).train()
    for _ in range(steps):
        quantizer(torch.randn(4, 20, 8, generator=generator), generator=generator)
    return quantizer, generator


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
    plain, patient = quantizer.encode(x), quantizer.encode(x, 0.5)

    def changes(codes):
        return int((codes[:, 1:] != codes[:, :-1]).sum())

    def missed(codes):
        return float((quantizer.decode(codes) - x).square().mean())

    assert changes(patient) < 0.7 * changes(plain)
    assert missed(patient) < 1.6 * missed(plain)
    assert torch.equal(patient[1:], quantizer.encode(x[1:], 0.5))


def test_missing_trailing_layers_equal_layers_of_minus_one():
    quantizer, generator = trained()
    codes = quantizer.eval().encode(torch.randn(2, 5, 8, generator=generator))
    masked = codes.clone()
    masked[..., 1:] = -1
    assert torch.equal(quantizer.decode(codes[..., :1]), quantizer.decode(masked))


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
        whole(batch)
    first, _ = trained(steps=0)
    for batch in batches[:3]:
        first(batch)
    second = ResidualVectorQuantizer(codes=16, width=8, layers=3).train()
    second.load_state_dict(first.state_dict())
    second.load_training_state({key: value.clone() for key, value in first.training_state().items()})
    for batch in batches[3:]:
        second(batch)
    for mine, theirs in zip(second.books(), whole.books(), strict=True):
        assert torch.equal(mine.codebook, theirs.codebook)
        assert torch.equal(mine.counts, theirs.counts)


def test_codebooks_taken_from_many_latents_halve_the_error_layer_by_layer():
    generator = torch.Generator().manual_seed(0)
    latents = torch.randn(400, 8, generator=generator)
    quantizer = ResidualVectorQuantizer(codes=64, width=8, layers=3, kmeans_steps=5)
    quantizer.initialise(latents, generator)
    codes = quantizer.encode(latents[None])
    errors = [float((quantizer.decode(codes[..., :q]) - latents).square().mean()) for q in (1, 2, 3)]
    assert errors[0] < 0.6
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.6 * errors[1]


def test_state_dict_has_the_released_names_only():
    assert list(ResidualVectorQuantizer(codes=4, width=2, layers=2).state_dict()) == [
        "layers.0.codebook",
        "layers.1.codebook",
    ]
