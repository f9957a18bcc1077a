"""The tensors that the published files must contain: names as published, and shapes."""

from collections.abc import Mapping, Sequence

import torch
from torch import nn

from echoavatar.models.face import HubertConfig
from echoavatar.models.face.encoder import HubertEncoder
from echoavatar.models.generator import Generator, GeneratorConfig
from echoavatar.models.tokenizer import MotionTokenizer, MotionTokenizerConfig

Shape = tuple[int, ...]
Shapes = dict[str, Shape]
HUBERT = "audio_encoder."
OPTIONAL = ("masked_spec_embed",)  # used in training alone; transformers omits it where nothing is masked
FACE_BLOCKS, HEAD_BLOCKS, TIMES, LONGEST = 4, 3, 64, 1024


def tokenizer_shapes(config: MotionTokenizerConfig) -> Shapes:
    """Tensors of one body part's tokenizer; our names are those of the release."""
    with torch.device("meta"):
        return _shapes(MotionTokenizer(config))


def generator_shapes(config: GeneratorConfig) -> Shapes:
    """Tensors of a generator with separate input and output embeddings, named as in transformers' Qwen2."""
    with torch.device("meta"):
        return _shapes(Generator(config))


def face_shapes(width: int, channels: int, hubert: HubertConfig) -> Shapes:
    """Tensors of the face model and its HuBERT audio encoder."""
    shapes: Shapes = {}

    def linear(name: str, outputs: int, inputs: int) -> None:
        shapes[f"{name}.weight"], shapes[f"{name}.bias"] = (outputs, inputs), (outputs,)

    def norm(name: str) -> None:
        shapes[f"{name}.weight"] = shapes[f"{name}.bias"] = (width,)

    linear("audio_proj", width, hubert.width)
    linear("face_embed", width, channels)
    linear("time_embed.time_embedder.linear_1", width, TIMES)
    linear("time_embed.time_embedder.linear_2", width, width)
    for block in range(FACE_BLOCKS):
        at = f"blocks.{block}"
        for index in range(1, 5):
            norm(f"{at}.norm{index}")
        for kind in ("rope", "pos"):
            own = f"{at}.self_attn_{kind}.self_attn"
            shapes[f"{own}.in_proj_weight"], shapes[f"{own}.in_proj_bias"] = (3 * width, width), (3 * width,)
            linear(f"{own}.out_proj", width, width)
        for angle in ("cos", "sin"):
            shapes[f"{at}.self_attn_rope.rope.{angle}_angles"] = (LONGEST, width // 2)
        shapes[f"{at}.self_attn_pos.pe.pe"] = (1, LONGEST, width)
        linear(f"{at}.mlp.fc1", 4 * width, width)
        linear(f"{at}.mlp.fc2", width, 4 * width)
    norm("output_norm")
    linear("output_proj", channels, width)
    for name in ("noisy_proj", "gpt_proj", "past_proj", "anchor_proj"):
        linear(f"diffusion_head.{name}", width, channels)
    for block in range(HEAD_BLOCKS):
        for half in (1, 2):
            linear(f"diffusion_head.blocks.{block}.mlp{half}.fc1", 4 * width, width)
            linear(f"diffusion_head.blocks.{block}.mlp{half}.fc2", width, 4 * width)
            linear(f"diffusion_head.blocks.{block}.adaLN_modulation{half}.1", 3 * width, width)
    norm("diffusion_head.output_norm")
    linear("diffusion_head.output_proj", channels, width)
    with torch.device("meta"):
        encoder = _shapes(HubertEncoder(hubert).hubert)
    return shapes | {HUBERT + key: shape for key, shape in encoder.items()}


def hubert_of(shapes: Mapping[str, Sequence[int]]) -> HubertConfig:
    """Sizes of the HuBERT inside a face model, from the shapes of a few of its tensors.

    Raises:
        KeyError: one of these tensors is missing; the message is its name.
    """
    width = shapes[HUBERT + "encoder.layer_norm.weight"][0]
    kernel = shapes[HUBERT + "encoder.pos_conv_embed.conv.parametrizations.weight.original1"]
    dense = shapes[HUBERT + "encoder.layers.0.feed_forward.intermediate_dense.weight"]
    stem = HUBERT + "feature_extractor.conv_layers."
    return HubertConfig(
        width=width,
        layers=len({key.split(".")[3] for key in shapes if key.startswith(HUBERT + "encoder.layers.")}),
        heads=max(1, width // 64),
        mlp=dense[0],
        convolutions=tuple(shapes[f"{stem}{layer}.conv.weight"][0] for layer in range(7)),
        position_kernel=kernel[2],
        position_groups=width // kernel[1],
    )


def differences(found: Mapping[str, Sequence[int]], wanted: Shapes, *, origin: str) -> list[str]:
    """One line for each tensor that is missing, unknown or of another shape; empty where all fit."""
    problems = [
        f"{origin}: {key} {list(shape)} is missing"
        for key, shape in wanted.items()
        if key not in found and not key.endswith(OPTIONAL)
    ]
    problems += [f"{origin}: {key} {list(shape)} is unknown" for key, shape in found.items() if key not in wanted]
    problems += [
        f"{origin}: {key} is {list(found[key])}, wanted {list(shape)}"
        for key, shape in wanted.items()
        if key in found and tuple(found[key]) != shape
    ]
    return problems


def _shapes(module: nn.Module) -> Shapes:
    return {key: tuple(value.shape) for key, value in module.state_dict().items()}
