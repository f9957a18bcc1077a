import pytest
import torch

from echoavatar.models.tokenizer import MotionTokenizer, MotionTokenizerConfig
from echoavatar_lab.models.tokenizer.start import start_from_principal_axes


def test_before_the_first_step_every_frame_is_the_mean_of_its_four():
    """10 features that live on 6 axes, 8 channels: nothing is lost but the motion inside a token."""
    generator = torch.Generator().manual_seed(0)
    frames = torch.randn(400, 6, generator=generator) @ torch.randn(6, 10, generator=generator)
    frames = frames - frames.mean(0)
    tokenizer = MotionTokenizer(MotionTokenizerConfig(features=10, width=8, heads=2))
    start_from_principal_axes(tokenizer, frames)
    x = frames[None, :64]
    with torch.no_grad():
        found = tokenizer.from_latents(tokenizer.to_latents(x))
    mean = x.view(1, 16, 4, 10).mean(2).repeat_interleave(4, 1)
    torch.testing.assert_close(found, mean, atol=1e-4, rtol=0)


def test_every_branch_still_learns():
    tokenizer = MotionTokenizer(MotionTokenizerConfig(features=10, width=16, heads=2))
    frames = torch.randn(64, 10, generator=torch.Generator().manual_seed(0))
    start_from_principal_axes(tokenizer, frames)
    (tokenizer.from_latents(tokenizer.to_latents(frames[None])) - frames).square().mean().backward()
    branches = [tokenizer.encoder[0].attn.proj, tokenizer.down_sample[0].fc2, tokenizer.up_sample[1].fc2]
    assert all(layer.weight.grad.abs().sum() > 0 for layer in branches)


def test_axes_need_a_short_path():
    tokenizer = MotionTokenizer(MotionTokenizerConfig(features=10, width=16, heads=2, resampling="learned"))
    with pytest.raises(ValueError, match="principal start"):
        start_from_principal_axes(tokenizer, torch.zeros(8, 10))
