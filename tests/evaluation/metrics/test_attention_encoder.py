"""The autoencoder that sees both ways, against the released module's numbers."""

import hashlib

import numpy as np
import torch
from tests import golden as fixtures
from tests.parity.test_reference_tokenizer import procedural

from echoavatar.checkpoint import load_into
from echoavatar.evaluation.metrics.attention_encoder import AttentionAutoencoder, within


@torch.no_grad()
def test_it_gives_the_released_numbers() -> None:
    stored = np.load(fixtures.golden("reference_release/ae_small.npz"))
    golden = {name: torch.from_numpy(array) for name, array in stored.items()}
    model = AttentionAutoencoder(features=531, width=64).eval()
    weights = procedural({key: tuple(value.shape) for key, value in model.state_dict().items()}, 3001)
    digest = hashlib.sha256(b"".join(key.encode() + weights[key].numpy().tobytes() for key in sorted(weights)))
    assert digest.hexdigest() == "5728dab0c27e299f2f80be73d5052428ae6e01f5f4206c1bcdc4bd95fab820ba"
    load_into(model, weights, origin="procedural weights")
    torch.testing.assert_close(model.encode(golden["x"]), golden["latent"], atol=5e-5, rtol=0)
    torch.testing.assert_close(model(golden["x"]), golden["rec"], atol=5e-5, rtol=0)


def test_a_frame_sees_as_far_ahead_as_back() -> None:
    assert within(5, 1).int().tolist()[2] == [0, 1, 1, 1, 0]
    torch.manual_seed(0)
    model, x = AttentionAutoencoder(features=3, width=16).eval(), torch.randn(1, 128, 3)
    changed = x.clone()
    changed[:, 64] += 1
    with torch.no_grad():
        moved = (model.encode(x) - model.encode(changed)).abs().amax(-1)[0].nonzero().flatten()
    assert moved.min() < 16 < moved.max()
    assert moved.max() - 16 <= 11
    assert 16 - moved.min() <= 11
