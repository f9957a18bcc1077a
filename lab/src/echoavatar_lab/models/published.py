"""Weights as others publish them, read by transformers: EnCodec (codec), HuBERT (face), Qwen2.5 (generator's body).

They come from a folder or the local model cache, never from the network.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch.nn.modules.module import (
    register_module_module_registration_hook,
    register_module_parameter_registration_hook,
)
from torch.nn.utils import parametrize

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.json_reader import read_json
from echoavatar.limits import CONFIG_BYTES, check_file, read_bytes
from echoavatar.models.audio import CodecConfig
from echoavatar.models.audio.codec_config import CODE_LAYERS
from echoavatar.models.face import HubertConfig
from echoavatar.stored import LARGEST_WEIGHTS_BYTES, check_weights
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_lab.foreign.foreign_files import check_torch_file
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.face.encoder import HubertEncoder, find_transformers
from echoavatar_lab.models.generator.model import Generator

_MODULES, _PARAMETERS, _NUMBERS = 3_000, 5_000, 1 << 33  # Qwen2.5 and HuBERT have some hundred modules


def read_encodec(path_or_name: str | Path = "facebook/encodec_24khz") -> AudioCodec:
    """EnCodec as published.

    Raises:
        CheckpointError: it is not there, or is not a causal 24 kHz model.
        DependencyError: transformers is not installed.
    """
    network = _read("EncodecModel", "an EnCodec", path_or_name, "the bundled codec")
    for module in network.modules():  # (direction, length) pairs become plain weights: the same function, faster
        if parametrize.is_parametrized(module):
            parametrize.remove_parametrizations(module, "weight", leave_parametrized=True)
    codec = AudioCodec(_codec_config(network.config, origin=str(path_or_name)))
    codec.encoder.load_state_dict(network.encoder.state_dict())
    codec.decoder.load_state_dict(network.decoder.state_dict())
    for q in range(CODE_LAYERS):
        codec.codebooks[q] = network.quantizer.layers[q].codebook.embed
    return codec.eval()


def read_hubert(path_or_name: str | Path) -> HubertEncoder:
    """HuBERT as published (base size).

    Raises:
        CheckpointError: it is not there.
        DependencyError: transformers is not installed.
    """
    network = _read("HubertModel", "a HuBERT", path_or_name, "the mel encoder")
    encoder = HubertEncoder(_hubert_config(network.config))
    encoder.hubert.load_state_dict(network.state_dict())
    return encoder.eval()


def init_from_qwen(generator: Generator, folder: Path) -> None:
    """Copy the body of a local Qwen2 checkpoint; embeddings and head keep their new, detached rows.

    Where the vocabulary begins with Qwen's text rows (the reference layout) these are copied too. Raises
    CheckpointError if the folder is missing or holds a model of another shape.
    """
    if not (folder / "config.json").exists():
        raise CheckpointError(
            f"{folder} holds no Qwen2 checkpoint; download Qwen/Qwen2.5-0.5B-Instruct and pass its folder"
        )
    source = _read("Qwen2ForCausalLM", "a Qwen2", folder, "random weights", dtype=torch.float32)
    weights, own = source.state_dict(), generator.state_dict()
    body = {key: value for key, value in weights.items() if key in own and _is_body(key)}
    wrong = [key for key in own if _is_body(key) and (key not in body or body[key].shape != own[key].shape)]
    if wrong:
        raise CheckpointError(f"{folder} does not fit this generator: {wrong[0]} and {len(wrong) - 1} more differ")
    generator.load_state_dict(body, strict=False)
    text = generator.config.layout.audio_base
    with torch.no_grad():
        if text > 1000:  # the vocabulary begins with Qwen's text rows
            rows = min(text, weights["model.embed_tokens.weight"].shape[0])
            generator.model.embed_tokens.weight[:rows] = weights["model.embed_tokens.weight"][:rows]
            if generator.depth is None:  # whose heads are as wide as the body
                generator.lm_head.weight[:rows] = weights["lm_head.weight"][:rows]


def _is_body(key: str) -> bool:
    return key.startswith("model.") and not key.startswith("model.embed_tokens")


def _read(kind: str, name: str, path_or_name: str | Path, instead: str, **how: Any) -> Any:
    """The network of a class of transformers. A folder may be a stranger's: it is checked before transformers reads it.

    Raises CheckpointError if there is none, it would run something, or asks for more than such a network has.
    """
    network = getattr(find_transformers(), kind)
    try:
        for path in sorted(Path(path_or_name).glob("*")):
            if path.name in ("config.json", "generation_config.json") or path.name.endswith(".index.json"):
                read_json(read_bytes(path, CONFIG_BYTES), path.name)
            elif path.suffix == ".safetensors":
                check_weights(path)
            elif path.suffix == ".bin":
                check_file(path, LARGEST_WEIGHTS_BYTES)
                check_torch_file(path)
        with _bounded():
            return network.from_pretrained(str(path_or_name), local_files_only=True, **how)
    except (EchoAvatarError, _TooLargeError) as error:
        raise CheckpointError(f"{path_or_name} holds no {name.split()[-1]}: {error}; use {instead}") from error
    except Exception as error:  # transformers raises errors of any kind for what it cannot read
        raise CheckpointError(
            f"{path_or_name} is neither a folder with {name} model nor in the local model cache "
            f"({type(error).__name__}: {str(error)[:120]}); fetch it with "
            f"'hf download {path_or_name}' where there is network, or use {instead}"
        ) from error


class _TooLargeError(Exception):
    """A network is larger than any that is read here."""


@contextmanager
def _bounded() -> Iterator[None]:
    """While this thread builds a network, it may not outgrow the published ones by far: in modules, or in numbers."""
    left = {"modules": _MODULES, "parameters": _PARAMETERS, "numbers": _NUMBERS}
    thread = threading.get_ident()

    def spend(what: str, number: int) -> None:
        left[what] -= number if threading.get_ident() == thread else 0
        if left[what] < 0:
            raise _TooLargeError(f"its config asks for more {what} than any published model has")

    def count(module: torch.nn.Module, name: str, parameter: torch.nn.Parameter | None) -> None:
        spend("parameters", 1)
        spend("numbers", 0 if parameter is None else parameter.numel())

    hooks = (
        register_module_module_registration_hook(lambda *_: spend("modules", 1)),
        register_module_parameter_registration_hook(count),
    )
    try:
        yield
    finally:
        for hook in hooks:
            hook.remove()


def _codec_config(theirs: Any, *, origin: str) -> CodecConfig:
    """Our fields of a transformers config; refuses models that cannot stream at our clock."""
    if not theirs.use_causal_conv or theirs.sampling_rate != SAMPLE_RATE_HZ or theirs.audio_channels != 1:
        raise CheckpointError(f"{origin} is not the causal, mono, 24 kHz EnCodec; use facebook/encodec_24khz")
    can_stream = theirs.norm_type == "weight_norm" and theirs.trim_right_ratio == 1.0
    if theirs.normalize or not can_stream or theirs.chunk_length_s is not None:
        raise CheckpointError(f"{origin} normalises over time and cannot stream; use facebook/encodec_24khz")
    return CodecConfig(
        filters=theirs.num_filters,
        width=theirs.hidden_size,
        codes=theirs.codebook_size,
        ratios=tuple(theirs.upsampling_ratios),
        lstm_layers=theirs.num_lstm_layers,
        residual_blocks=theirs.num_residual_layers,
        kernel=theirs.kernel_size,
        last_kernel=theirs.last_kernel_size,
        residual_kernel=theirs.residual_kernel_size,
        dilation_growth=theirs.dilation_growth_rate,
        compress=theirs.compress,
        has_conv_shortcut=theirs.use_conv_shortcut,
        padding=theirs.pad_mode,
    )


def _hubert_config(theirs: Any) -> HubertConfig:
    return HubertConfig(
        width=theirs.hidden_size,
        layers=theirs.num_hidden_layers,
        heads=theirs.num_attention_heads,
        mlp=theirs.intermediate_size,
        convolutions=tuple(theirs.conv_dim),
        position_kernel=theirs.num_conv_pos_embeddings,
        position_groups=theirs.num_conv_pos_embedding_groups,
    )
