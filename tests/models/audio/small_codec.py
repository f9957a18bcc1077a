"""A tiny codec and transformers' own model with the same weights."""

import torch
from transformers import EncodecConfig, EncodecModel

from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.published import read_encodec

TINY = {
    "num_filters": 2,
    "hidden_size": 16,
    "codebook_size": 64,
    "target_bandwidths": [0.9],  # two layers of 6 bits at 75 Hz
    "num_lstm_layers": 2,
}


def reference(**fields: object) -> EncodecModel:
    """Random weights; codebooks of the size of the latents."""
    torch.manual_seed(0)
    model = EncodecModel(EncodecConfig(**(TINY | fields))).eval()
    for layer in model.quantizer.layers:
        layer.codebook.embed.normal_(std=0.3)
    return model


def ours(model: EncodecModel, folder: object) -> AudioCodec:
    model.save_pretrained(folder)
    return read_encodec(str(folder))
