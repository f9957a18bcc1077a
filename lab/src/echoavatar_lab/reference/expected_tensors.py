"""The tensors that the published files must contain, as published; and the face model's under our names.

The face model's mapping is by name only. Give the tensors of the release's `gpt` dictionary, as safetensors: nothing is
unpickled.
"""

import re
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from echoavatar.models.face import HubertConfig
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar_lab.models.face.encoder import HubertEncoder
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.tokenizer.model import MotionTokenizer

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

    Raises KeyError if one of these tensors is missing; the message is its name.
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
