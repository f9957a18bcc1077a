import pytest
import torch
from pydantic import ValidationError

from echoavatar.models.tokenizer import MotionTokenizer, MotionTokenizerConfig

CONFIG = MotionTokenizerConfig(features=10, width=16, heads=2, layers=3, codes=24)


@pytest.fixture
def tokenizer() -> MotionTokenizer:
    torch.manual_seed(0)
    model = MotionTokenizer(CONFIG).double()
    for book in model.quantizer.books():
        torch.nn.init.normal_(book.codebook)
    return model.eval()


def frames(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(rows, length, 10, generator=generator, dtype=torch.double)


def codes(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randint(0, 24, (rows, length, 3), generator=generator)


def test_a_token_depends_on_45_frames_by_gradient(tokenizer):
    """Token 12 of 15 sees frames 4 * 12 - 41 = 7 up to 4 * 12 + 3 = 51."""
    x = frames(1, 60, torch.Generator().manual_seed(0)).requires_grad_()
    tokenizer.to_latents(x)[0, 12].sum().backward()
    seen = x.grad[0].abs().sum(-1).nonzero().flatten().tolist()
    assert seen == list(range(7, 52))


def test_a_frame_depends_on_twelve_tokens_by_gradient(tokenizer):
    """Frame 56 (the first of token 14) sees tokens 3..14; 55 (the last of 13) sees 3..13."""
    z = torch.randn(1, 16, 16, dtype=torch.double, requires_grad=True)
    for frame, first, last in ((56, 3, 14), (55, 3, 13)):
        z.grad = None
        tokenizer.from_latents(z)[0, frame].sum().backward()
        seen = z.grad[0].abs().sum(-1).nonzero().flatten().tolist()
        assert seen == list(range(first, last + 1))


def test_trailing_layers_may_be_missing(tokenizer):
    some = codes(1, 4, torch.Generator().manual_seed(0))
    masked = some.clone()
    masked[..., 1:] = -1
    torch.testing.assert_close(tokenizer.decode(some[..., :1]), tokenizer.decode(masked))


def test_frames_must_fill_whole_tokens(tokenizer):
    with pytest.raises(ValueError, match="multiple of 4"):
        tokenizer.encode(torch.zeros(1, 6, 10, dtype=torch.double))


def test_lookback_halves_with_the_rate():
    assert [CONFIG.lookback_at(level) for level in range(3)] == [15, 7, 3]


def test_heads_must_divide_the_width():
    with pytest.raises(ValidationError, match="twice the heads"):
        MotionTokenizerConfig(features=4, width=12, heads=4)


def test_without_look_back_a_token_sees_its_own_four_frames_only():
    """So a stream in pieces must give what a whole clip gives."""
    model = MotionTokenizer(CONFIG.model_copy(update={"lookback": 0})).double()
    x = frames(1, 32, torch.Generator().manual_seed(0)).requires_grad_()
    model.to_latents(x)[0, 5].sum().backward()
    assert x.grad[0].abs().sum(-1).nonzero().flatten().tolist() == [20, 21, 22, 23]
    state, every = model.init_encoder(1), torch.ones(1, dtype=torch.bool)
    with torch.no_grad():
        pieces = [model.latents_step(piece, state, every) for piece in x.split(12, 1)]
        torch.testing.assert_close(torch.cat(pieces, 1), model.to_latents(x))


def test_without_the_dual_path_only_the_mlp_carries():
    """Silence the MLPs: the dual path still brings a mean, the learned one nothing but biases."""
    x = frames(1, 8, torch.Generator().manual_seed(0))
    for resampling, carries in (("dual", True), ("learned", False)):
        model = MotionTokenizer(CONFIG.model_copy(update={"resampling": resampling, "lookback": 0})).double()
        for mlp in model.down_sample:
            torch.nn.init.zeros_(mlp.fc2.weight)
        with torch.no_grad():
            found = model.to_latents(x)
        assert (not torch.allclose(found[0, 0], found[0, 1])) == carries
