import pytest
import torch
from tests.laws.cases import decoding, encoding
from tests.laws.streaming import hold
from tests.models.motion_tokens import fill

from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar_lab.models.tokenizer.variants import AnyTokenizer, CausalConvBlock, CausalConvolution
from echoavatar_lab.nn.blocks import CausalBlock

CONFIG = MotionTokenizerConfig(features=10, width=16, heads=2, layers=3, codes=24)


def frames(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(rows, length, 16, generator=generator, dtype=torch.double)


def test_a_convolution_sees_the_present_and_two_dilated_steps_back():
    """With weights of one the answer to a unit impulse at 0 is one at 0, 3 and 6."""
    conv = CausalConvolution(width=1, dilation=3)
    torch.nn.init.ones_(conv.conv.weight)
    torch.nn.init.zeros_(conv.conv.bias)
    x = torch.zeros(1, 9, 1)
    x[0, 0] = 1
    assert conv(x)[0, :, 0].nonzero().flatten().tolist() == [0, 3, 6]


def test_a_block_sees_26_positions_back():
    block = CausalConvBlock(width=16).double()
    x = frames(1, 40, torch.Generator().manual_seed(0)).requires_grad_()
    block(x)[0, 35].sum().backward()
    assert x.grad[0].abs().sum(-1).nonzero().flatten().tolist()[0] == 35 - 26


def test_it_weighs_what_an_attention_block_does():
    def matrices(block: torch.nn.Module) -> int:
        return sum(p.numel() for p in block.parameters() if p.dim() > 1)

    assert matrices(CausalConvBlock(width=32)) == matrices(CausalBlock(width=32, heads=2, lookback=3))


def test_without_the_dual_path_only_the_mlp_carries():
    """Silence the MLPs: the dual path still brings a mean, the learned one nothing but biases."""
    x = torch.randn(1, 8, 10, generator=torch.Generator().manual_seed(0), dtype=torch.double)
    for resampling, carries in (("dual", True), ("learned", False)):
        model = AnyTokenizer(CONFIG.model_copy(update={"resampling": resampling, "lookback": 0})).double()
        for mlp in model.down_sample:
            torch.nn.init.zeros_(mlp.fc2.weight)
        with torch.no_grad():
            found = model.to_latents(x)
        assert (not torch.allclose(found[0, 0], found[0, 1])) == carries


@pytest.mark.parametrize(
    "changes",
    [{"blocks": "convolution", "resampling": "strided"}, {"resampling": "learned"}],
    ids=["convolutions", "learned"],
)
@torch.no_grad()
def test_the_streaming_laws_hold(changes):
    torch.manual_seed(0)
    model = AnyTokenizer(CONFIG.model_copy(update=changes)).double().eval()
    fill(model.quantizer)
    hold(encoding(model), lambda *of: torch.randn(*of[:2], 10, generator=of[2], dtype=torch.double), unit=4, atol=0)
    hold(decoding(model), lambda *of: torch.randint(24, (*of[:2], 3), generator=of[2]), atol=1e-6)
