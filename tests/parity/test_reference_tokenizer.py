"""Our tokenizer against the released implementation, run with random weights (tests/fixtures/golden)."""

import numpy as np
import pytest
import torch
from tests import golden as fixtures

from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar_lab.checkpoint import load_into
from echoavatar_lab.models.tokenizer.model import MotionTokenizer
from echoavatar_lab.models.tokenizer.train import learning_quantizer
from echoavatar_lab.nn.attention import lookback_mask


def procedural(shapes: dict[str, tuple[int, ...]], seed: int) -> dict[str, torch.Tensor]:
    """Weights as the fixtures' README describes them: one stream of uniform numbers over the sorted keys."""
    stream = np.random.Generator(np.random.PCG64(seed))
    weights = {}
    for key in sorted(shapes):
        shape = shapes[key]
        u = stream.random(int(np.prod(shape))) * 2 - 1
        if key.endswith("codebook"):
            u = u * 2.0 * 0.6 ** int(key.split(".")[-2])
        elif len(shape) == 1:
            u = 1 + 0.1 * u if key.endswith("weight") else 0.05 * u
        else:
            u = u * np.sqrt(3 / np.prod(shape[1:]))
        weights[key] = torch.from_numpy(u.reshape(shape).astype(np.float32))
    return weights


@pytest.fixture(scope="module")
def golden() -> dict[str, torch.Tensor]:
    return {
        name: torch.from_numpy(value)
        for name, value in np.load(fixtures.golden("reference_release/tok_small_lower.npz")).items()
    }


@pytest.fixture(scope="module")
def model() -> MotionTokenizer:
    config = MotionTokenizerConfig(features=117, width=64, heads=8, layers=6, codes=32)
    tokenizer = MotionTokenizer(config).eval()
    weights = procedural({key: tuple(value.shape) for key, value in tokenizer.state_dict().items()}, 1001)
    load_into(tokenizer, weights, origin="procedural weights")
    return tokenizer


def near(ours: torch.Tensor, theirs: torch.Tensor) -> None:
    torch.testing.assert_close(ours, theirs, atol=2e-5, rtol=0)


@torch.no_grad()
def test_latents_and_codes(model, golden):
    near(model.to_latents(golden["x"]), golden["latent"])
    assert torch.equal(model.encode(golden["x"]), golden["codes"])
    assert torch.equal(model.encode(golden["x100"]), golden["codes100"])


@torch.no_grad()
def test_codes_become_vectors_and_frames(model, golden):
    near(model.quantizer.decode(golden["codes"]), golden["z_q"])
    near(model.decode(golden["codes"]), golden["dec"])
    near(model.decode(golden["codes30"]), golden["dec30"])
    near(model.decode(golden["codes_masked"]), golden["dec_masked"])
    for layers in (1, 3):
        near(model.decode(golden["codes"][..., :layers]), golden[f"dec_first{layers}"])


@torch.no_grad()
def test_blocks_one_by_one(model, golden):
    h = model.input_liner(golden["x"])
    near(h, golden["in_proj"])
    near(model.encoder[0](h), golden["enc_block0"])
    near(model.decoder[0](golden["z_q"]), golden["dec_block0"])


@torch.no_grad()
def test_eval_pass_and_commitment(model, golden):
    quantizer = learning_quantizer(model.config).eval()
    quantizer.load_state_dict(model.quantizer.state_dict())
    result = quantizer(model.to_latents(golden["x"]))
    near(model.from_latents(result.latents), golden["fwd_rec"])
    near(result.commitment, golden["fwd_commit"])
    near(model.from_latents(quantizer(model.to_latents(golden["x100"])).latents), golden["fwd_once_rec100"])


@torch.no_grad()
def test_streams_give_the_released_numbers(model, golden):
    active = torch.ones(1, dtype=torch.bool)
    encoder, decoder = model.init_encoder(1), model.init_decoder(1)
    latents = torch.cat([model.latents_step(x, encoder, active) for x in golden["x"].split(8, 1)], 1)
    codes = model.quantizer.encode(latents)
    assert torch.equal(codes, golden["codes"])
    near(torch.cat([model.decode_step(c, decoder, active) for c in codes.split(2, 1)], 1), golden["dec"])


def test_masks():
    masks = np.load(fixtures.golden("reference_release/tok_masks.npz"))
    for name in masks.files:
        size, lookback = (int(part) for part in name.removeprefix("mask").split("_lb"))
        assert np.array_equal(lookback_mask(size, lookback).numpy(), masks[name]), name
    assert len(masks.files) == 4
