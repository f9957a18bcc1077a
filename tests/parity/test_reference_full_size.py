"""The published sizes with the fixtures' procedural weights: the very weights by their hash, and what was measured."""

import hashlib
import json

import numpy as np
import pytest
import torch
from tests import golden as fixtures
from tests.parity.test_reference_tokenizer import procedural

from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar_lab.checkpoint import load_into
from echoavatar_lab.models.tokenizer.measure import code_usage
from echoavatar_lab.models.tokenizer.model import MotionTokenizer


def told() -> dict:
    return json.loads(fixtures.golden("reference_release/meta.json").read_text())


def digest(weights: dict[str, torch.Tensor]) -> str:
    found = hashlib.sha256()
    for key in sorted(weights):
        found.update(key.encode())
        found.update(weights[key].numpy().tobytes())
    return found.hexdigest()


def drawn(model: torch.nn.Module, seed: int) -> dict[str, torch.Tensor]:
    return procedural({key: tuple(value.shape) for key, value in model.state_dict().items()}, seed)


@pytest.mark.slow
@pytest.mark.parametrize(("part", "features"), [("lower", 117), ("upper", 162), ("hands", 252)])
@torch.no_grad()
def test_a_tokenizer_of_the_published_size(part: str, features: int) -> None:
    """The last 12 frames need 14 tokens (13 are off by thousandths), frame 0 reaches tokens 0 to 10; streams agree."""
    facts, recorded = told()[f"tok_default_{part}.facts"], told()[f"tok_default_{part}.weights"]
    model = MotionTokenizer(MotionTokenizerConfig(features=features)).eval()
    weights = drawn(model, recorded["procedural_seed"])
    assert digest(weights) == recorded["sha256"]
    assert sum(value.numel() for value in weights.values()) == recorded["numel"]
    load_into(model, weights, origin="procedural weights")
    random = torch.Generator().manual_seed(0)
    codes = torch.randint(512, (1, 30, 6), generator=random)
    whole = model.decode(codes)
    assert 1 < whole.abs().max() < 100
    for context, published in facts["tail12_err_vs_latent_context"].items():
        error = float((model.decode(codes[:, -int(context) :])[:, -12:] - whole[:, -12:]).abs().max())
        far = 10 if context == "13" else 2  # at 13 a single code decides
        assert published / far < error < published * far if int(context) < 14 else error < 2e-5, context
    x = torch.randn(1, 64, features, generator=random)
    changed = x.clone()
    changed[:, 0] += 1
    moved = (model.to_latents(x) - model.to_latents(changed)).abs().amax(-1)[0].nonzero().flatten()
    assert moved.tolist() == facts["latents_changed_by_frame0"]
    active = torch.ones(1, dtype=torch.bool)
    encoder, decoder = model.init_encoder(1), model.init_decoder(1)
    streamed = torch.cat([model.latents_step(piece, encoder, active) for piece in x.split(8, 1)], 1)
    assert torch.equal(model.quantizer.encode(streamed), model.encode(x))
    frames = torch.cat([model.decode_step(piece, decoder, active) for piece in codes.split(2, 1)], 1)
    torch.testing.assert_close(frames, whole, atol=2e-5, rtol=0)


def test_the_small_weights_by_their_hash() -> None:
    from safetensors.torch import load_file

    stored = load_file(fixtures.golden("reference_release/tok_small_lower.safetensors"))
    assert digest(stored) == told()["tok_small_lower.weights"]["sha256"]
    face = load_file(fixtures.golden("reference_release/face_core.safetensors"))
    own = {key: value for key, value in face.items() if not key.endswith((".cos_angles", ".sin_angles", ".pe"))}
    shapes = {key: tuple(value.shape) for key, value in own.items()}
    weights = procedural(shapes, told()["face_core.weights"]["procedural_seed"])
    assert digest(weights) == told()["face_core.weights"]["sha256"]
    assert all(torch.equal(weights[key], own[key]) for key in own)


@torch.no_grad()
def test_what_else_is_stored_of_the_small_tokenizer() -> None:
    """Blocks behind each level, the vectors of every layer, and the perplexity of its codes."""
    golden = {
        name: torch.from_numpy(value)
        for name, value in np.load(fixtures.golden("reference_release/tok_small_lower.npz")).items()
    }
    model = MotionTokenizer(MotionTokenizerConfig(features=117, width=64, heads=8, layers=6, codes=32)).eval()
    load_into(model, drawn(model, 1001), origin="procedural weights")
    seen: dict[str, torch.Tensor] = {}
    for name, blocks in (("enc", model.encoder), ("dec", model.decoder)):
        for level, block in enumerate(blocks):
            block.register_forward_hook(lambda _m, _x, y, at=f"{name}_block{level}": seen.update({at: y}))
    model.from_latents(model.quantizer.decode(model.encode(golden["x"])))
    assert len(seen) == 6
    for name, value in seen.items():
        torch.testing.assert_close(value, golden[name], atol=2e-5, rtol=0)
    vectors = torch.stack([book.lookup(golden["codes"][..., q]) for q, book in enumerate(model.quantizer.books())])
    torch.testing.assert_close(vectors, golden["codes_from_indices"], atol=1e-6, rtol=0)
    torch.testing.assert_close(vectors.transpose(2, 3), golden["all_codes"], atol=1e-6, rtol=0)
    perplexity = code_usage(golden["codes"], 32).perplexity.mean()
    assert float(perplexity) == pytest.approx(float(golden["fwd_perplexity"]), abs=1e-4)
