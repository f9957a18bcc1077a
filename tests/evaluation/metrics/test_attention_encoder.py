"""The autoencoder that sees both ways, against the released module's numbers."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.parity.test_reference_tokenizer import procedural

from echoavatar.checkpoint import load_into
from echoavatar.evaluation.metrics.attention_encoder import AttentionAutoencoder, within

FOLDER = Path(__file__).parents[3] / "../shared/golden/reference_release"
needs_golden = pytest.mark.skipif(not FOLDER.exists(), reason="the reference fixtures (../shared) are not here")


@needs_golden
@torch.no_grad()
def test_it_gives_the_released_numbers() -> None:
    golden = {name: torch.from_numpy(array) for name, array in np.load(FOLDER / "ae_small.npz").items()}
    model = AttentionAutoencoder(features=531, width=64).eval()
    weights = procedural({key: tuple(value.shape) for key, value in model.state_dict().items()}, 3001)
    digest = hashlib.sha256(b"".join(key.encode() + weights[key].numpy().tobytes() for key in sorted(weights)))
    assert digest.hexdigest() == json.loads((FOLDER / "meta.json").read_text())["ae_small.weights"]["sha256"]
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
