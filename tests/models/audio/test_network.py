import pytest
import torch
from tests.models.audio.small_codec import reference

from echoavatar.models.audio import CodecConfig
from echoavatar.models.audio.network import decoder, encoder


@pytest.mark.parametrize(("blocks", "shortcut"), [(0, False), (1, True), (2, False)])
def test_the_weights_have_the_published_names_and_shapes(blocks: int, shortcut: bool) -> None:
    """What they compute is compared in test_codec."""
    theirs = reference(num_residual_layers=blocks, use_conv_shortcut=shortcut, num_filters=4)
    config = CodecConfig(filters=4, width=16, residual_blocks=blocks, has_conv_shortcut=shortcut)
    for network, wanted in ((encoder(config), theirs.encoder), (decoder(config), theirs.decoder)):
        shapes = {
            name.replace("parametrizations.weight.original1", "weight"): weight.shape
            for name, weight in wanted.named_parameters()
            if not name.endswith("original0")
        }
        assert {name: weight.shape for name, weight in network.named_parameters()} == shapes


def test_fresh_weights_keep_the_loudness() -> None:
    torch.manual_seed(0)
    layer = encoder(CodecConfig(filters=64)).layers[2].conv
    heard = torch.randn(1, 64, 4_000).relu()
    assert 0.8 < layer(heard).std() / heard.square().mean().sqrt() / 2**0.5 < 1.25
