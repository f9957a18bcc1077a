"""Weights of the published face model under our names, so that a checkpoint of the release can be used and compared.

The mapping is by name only. Give the tensors of the release's `gpt` dictionary, as safetensors: nothing is unpickled.
"""

import re
from collections.abc import Mapping

import torch
from torch import Tensor

_RENAMED = (
    ("audio_proj.", "gpt.sound_proj."),
    ("face_embed.", "gpt.embed."),
    ("time_embed.time_embedder.linear_1.", "head.time_in."),
    ("time_embed.time_embedder.linear_2.", "head.time_out."),
    ("diffusion_head.gpt_proj.", "head.condition_proj."),
    ("diffusion_head.", "head."),
    ("blocks.", "gpt.blocks."),
    ("output_norm.", "gpt.output_norm."),
    ("output_proj.", "gpt.output_proj."),
)
_INNER = (
    (".self_attn_rope.self_attn.", ".attn1."),
    (".self_attn_pos.self_attn.", ".attn2."),
    (".in_proj_weight", ".qkv.weight"),
    (".in_proj_bias", ".qkv.bias"),
    (".out_proj.", ".proj."),
)
_MODULATION = re.compile(r"diffusion_head\.blocks\.\d+\.adaLN_modulation([12])\.1\.(weight|bias)")
_MLP = re.compile(r"diffusion_head\.blocks\.(\d+)\.mlp([12])\.(.+)")
_UNUSED = ("past_proj", "anchor_proj", "cos_angles", "sin_angles", ".pe.pe")


def from_reference(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The release's weights under the names of a `FaceModel(paper_face(width=64))`; unused ones are dropped."""
    renamed, steering = {}, dict[str, list[Tensor]]()
    for key in sorted(weights):
        value = weights[key]
        if any(part in key for part in _UNUSED):
            continue
        if key.startswith("audio_encoder."):
            renamed["encoder.hubert." + key.removeprefix("audio_encoder.")] = value
            continue
        modulation = _MODULATION.fullmatch(key)
        if modulation:
            which, kind = modulation.groups()
            name = f"head.{'by_time' if which == '1' else 'by_condition'}.{kind}"
            steering.setdefault(name, []).append(value)
            continue
        mlp = _MLP.fullmatch(key)
        if mlp:
            block, half, rest = mlp.groups()
            renamed[f"head.mlps.{2 * int(block) + int(half) - 1}.{rest}"] = value
            continue
        for old, new in _RENAMED:
            if key.startswith(old):
                key = new + key[len(old) :]
                break
        for old, new in _INNER:
            key = key.replace(old, new)
        renamed[key] = value
    return renamed | {name: torch.cat(values) for name, values in steering.items()}
