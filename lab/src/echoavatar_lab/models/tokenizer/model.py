"""Motion to codes and back: one causal attention RVQ-VAE per body part (paper, Motion Tokenizer; figure A, B, C).

Anatomically partitioned tokenisation: lower body, upper body and hands have codebooks of their own. `BodyTokenizer` is
the whole body, with statistics and skeleton in one checkpoint; `MotionTokenizer` is one part. A part has three levels
of attention at 30, 15 and 7.5 Hz, dual-path resampling between them, RVQ at the lowest. The state dict has the names of
the released checkpoints (`input_liner` is their spelling), which therefore load. `variants` has the blocks of the
paper's ablation.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from echoavatar.models.clip_tokenizer import ClipTokenizer
from echoavatar.models.tokenizer_config import BodyTokenizerConfig, MotionTokenizerConfig
from echoavatar.motion.kinematics import Skeleton, part_sizes
from echoavatar.nn import StreamState
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN
from echoavatar_lab import checkpoint
from echoavatar_lab.checkpoint import Checkpointed
from echoavatar_lab.data.feature_statistics import FeatureStatistics
from echoavatar_lab.models.quantize import ResidualVectorQuantizer
from echoavatar_lab.nn.blocks import CausalBlock, Mlp
from echoavatar_lab.nn.stream import StreamingModule
from echoavatar_lab.nn.torch_step import TorchStep

Block = Callable[[Tensor], Tensor]  # a layer that looks back, of one level
LEVELS = FRAMES_PER_MOTION_TOKEN.bit_length()  # 3: every level but the last halves the rate


def split_parts(skeleton: Skeleton, features: Float[Tensor, "*n c"]) -> dict[str, Float[Tensor, "*n d"]]:
    """The features of each part."""
    sizes = part_sizes(skeleton)
    return dict(zip(sizes, torch.split(features, list(sizes.values()), -1), strict=True))


@dataclass
class BlocksState(StreamState):
    """Past of each block of an encoder or decoder."""

    blocks: list[StreamState]


class MotionTokenizer(nn.Module):
    """Normalised features of one part <-> codes, four frames a token; causal in both directions."""

    def __init__(self, config: MotionTokenizerConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        down = range(LEVELS)
        self.input_liner = nn.Linear(config.features, width)
        self.encoder = nn.ModuleList(self.block(level) for level in down)
        self.down_sample = nn.ModuleList(self.resampler(2 * width, width) for _ in down[1:])
        self.quantizer = ResidualVectorQuantizer(codes=config.codes, width=width, layers=config.layers)
        self.decoder = nn.ModuleList(self.block(level) for level in reversed(down))
        self.up_sample = nn.ModuleList(self.resampler(width, 2 * width) for _ in down[1:])
        self.output_liner = nn.Linear(width, config.features)

    def encode(self, features: Float[Tensor, "b t c"]) -> Int[Tensor, "b n q"]:
        """Codes of normalised features; the number of frames must be a multiple of four."""
        return self.quantizer.encode(self.to_latents(features))

    def decode(self, codes: Int[Tensor, "b n q"]) -> Float[Tensor, "b t c"]:
        """Normalised features of codes; trailing layers may be missing or -1."""
        return self.from_latents(self.quantizer.decode(codes))

    def to_latents(
        self, features: Float[Tensor, "b t c"], blocks: Iterable[Block] | None = None
    ) -> Float[Tensor, "b n c2"]:
        """The encoder alone; `blocks` are its blocks with their streams, where clips are running."""
        if features.shape[1] % FRAMES_PER_MOTION_TOKEN:
            raise ValueError(f"{features.shape[1]} frames are not a multiple of {FRAMES_PER_MOTION_TOKEN}")
        steps: Iterable[Block] = blocks or self.encoder
        h: Tensor = self.input_liner(features)
        for level, block in enumerate(steps):
            h = block(h)
            if level + 1 < LEVELS:
                joined: Tensor = self.down_sample[level](h.reshape(h.shape[0], h.shape[1] // 2, -1))
                h = self.both_paths(joined, (h[:, 0::2] + h[:, 1::2]) / 2)
        return h

    def from_latents(
        self, latents: Float[Tensor, "b n c2"], blocks: Iterable[Block] | None = None
    ) -> Float[Tensor, "b t c"]:
        """The decoder alone; `blocks` as in `to_latents`."""
        steps: Iterable[Block] = blocks or self.decoder
        z = latents
        for level, block in enumerate(steps):
            z = block(z)
            if level + 1 < LEVELS:
                spread: Tensor = self.up_sample[level](z).reshape(z.shape[0], -1, z.shape[2])
                z = self.both_paths(spread, z.repeat_interleave(2, 1))
        result: Tensor = self.output_liner(z)
        return result

    def init_encoder(self, rows: int) -> BlocksState:
        """Encoder streams that have seen nothing."""
        return BlocksState([block.init_state(rows) for block in _blocks(self.encoder)])

    def init_decoder(self, rows: int) -> BlocksState:
        """Decoder streams that have seen nothing."""
        return BlocksState([block.init_state(rows) for block in _blocks(self.decoder)])

    def latents_step(
        self, features: Float[Tensor, "b t c"], state: BlocksState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b n c2"]:
        """The next 4k frames of running clips before they are quantised."""
        return self.to_latents(features, _steps(self.encoder, state, active))

    def decode_step(
        self, codes: Int[Tensor, "b n q"], state: BlocksState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b t c"]:
        """The next 4k frames of running clips from k tokens."""
        return self.from_latents(self.quantizer.decode(codes), _steps(self.decoder, state, active))

    def block(self, level: int) -> StreamingModule[Any]:
        """The layer of a level that looks back."""
        config = self.config
        if config.blocks != "attention":
            raise ValueError(f"{config.blocks} blocks run in the ablation alone")
        return CausalBlock(width=config.width, heads=config.heads, lookback=config.lookback_at(level))

    def resampler(self, inputs: int, outputs: int) -> nn.Module:
        """The learned path between two levels; its inputs are neighbouring frames side by side."""
        if self.config.resampling != "dual":
            raise ValueError(f"{self.config.resampling} resampling runs in the ablation alone")
        return Mlp(inputs=inputs, hidden=4 * self.config.width, outputs=outputs)

    def both_paths(self, learned: Float[Tensor, "b n c"], short: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        """Both paths between two levels together; `short` is the mean of neighbouring frames, or their copies."""
        return short + learned


def _blocks(modules: nn.ModuleList) -> list[StreamingModule[Any]]:
    return [module for module in modules if isinstance(module, StreamingModule)]


def _steps(modules: nn.ModuleList, state: BlocksState, active: Bool[Tensor, " b"]) -> list[Block]:
    """Each block's step on its own stream."""
    pairs = zip(_blocks(modules), state.blocks, strict=True)
    return [partial(block.step, state=past, active=active) for block, past in pairs]


PIECE_TOKENS = 60  # whole clips go through the streams in pieces of this length, so memory does not grow


@dataclass
class BodyState(StreamState):
    """Encoder or decoder streams of all parts."""

    parts: list[BlocksState]


class BodyTokenizer(Checkpointed):
    """Motion features (315 channels for our rig) <-> codes of every part and layer, four frames a token."""

    config_type = BodyTokenizerConfig
    part_type: ClassVar[type[MotionTokenizer]] = MotionTokenizer
    config: BodyTokenizerConfig
    mean: Tensor
    std: Tensor
    varies: Tensor

    def __init__(self, config: BodyTokenizerConfig) -> None:
        super().__init__()
        self.config = config
        self.skeleton = Skeleton(config.skeleton)
        size = sum(part.features for part in config.parts.values())
        self.parts = nn.ModuleDict({name: self.part_type(part) for name, part in config.parts.items()})
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))
        self.register_buffer("varies", torch.ones(size, dtype=torch.bool))

    @property
    def statistics(self) -> FeatureStatistics:
        """Normalisation of the features."""
        return FeatureStatistics(self.mean, self.std, self.varies)

    def tokenizers(self) -> dict[str, MotionTokenizer]:
        """The parts' tokenizers, in the order of the codes' part axis."""
        return {name: part for name, part in self.parts.items() if isinstance(part, MotionTokenizer)}

    def codebooks(self) -> Float[Tensor, "p q K c"]:
        """The code vectors of every part and layer."""
        parts = [torch.stack([book.codebook for book in part.quantizer.books()]) for part in self.tokenizers().values()]
        return torch.stack(parts)

    @torch.no_grad()
    def encode(self, features: Float[Tensor, "b t c"]) -> Int[Tensor, "b n p q"]:
        """Codes of whole clips; the number of frames must be a multiple of four."""
        parts = zip(self.tokenizers().values(), self.latents(features), strict=True)
        return torch.stack([tokenizer.quantizer.encode(latents) for tokenizer, latents in parts], 2)

    @torch.no_grad()
    def latents(self, features: Float[Tensor, "b t c"]) -> list[Float[Tensor, "b n c2"]]:
        """Whole clips before they are quantised, part by part."""
        active, found = _all(features), []
        parts = split_parts(self.skeleton, self.statistics.normalize(features))
        for name, tokenizer in self.tokenizers().items():
            state = tokenizer.init_encoder(features.shape[0])
            pieces = torch.split(parts[name], PIECE_TOKENS * FRAMES_PER_MOTION_TOKEN, 1)
            found.append(torch.cat([tokenizer.latents_step(piece, state, active) for piece in pieces], 1))
        return found

    @torch.no_grad()
    def decode(self, codes: Int[Tensor, "b n p q"]) -> Float[Tensor, "b t c"]:
        """Features (not normalised) of whole clips; trailing layers may be missing or -1."""
        state, active = self.init_decoder(codes.shape[0]), _all(codes)
        pieces = torch.split(codes, PIECE_TOKENS, 1)
        return torch.cat([self.decode_step(piece, state, active) for piece in pieces], 1)

    def clips(self) -> ClipTokenizer:
        """The same for arrays, clip by clip."""
        encoder = TorchStep(self.encode_step, self.init_encoder)
        return ClipTokenizer(self.config, encoder, TorchStep(self.decode_step, self.init_decoder), tokens=PIECE_TOKENS)

    def init_encoder(self, rows: int) -> BodyState:
        """Encoder streams that have seen nothing."""
        return BodyState([part.init_encoder(rows) for part in self.tokenizers().values()])

    def encode_step(
        self, features: Float[Tensor, "b t c"], state: BodyState, active: Bool[Tensor, " b"]
    ) -> Int[Tensor, "b n p q"]:
        """The codes of the next 4k frames of running clips."""
        parts = split_parts(self.skeleton, self.statistics.normalize(features))
        pairs = zip(self.tokenizers().items(), state.parts, strict=True)
        return torch.stack(
            [own.quantizer.encode(own.latents_step(parts[name], past, active)) for (name, own), past in pairs], 2
        )

    def init_decoder(self, rows: int) -> BodyState:
        """Decoder streams that have seen nothing."""
        return BodyState([part.init_decoder(rows) for part in self.tokenizers().values()])

    def decode_step(
        self, codes: Int[Tensor, "b n p q"], state: BodyState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b t c"]:
        """The next 4k frames of running clips from k tokens: features, not normalised."""
        parts = [
            tokenizer.decode_step(codes[:, :, p], part, active)
            for p, (tokenizer, part) in enumerate(zip(self.tokenizers().values(), state.parts, strict=True))
        ]
        return self.statistics.denormalize(torch.cat(parts, -1))

    def save(self, folder: Path, card: Mapping[str, object], *, dtype: torch.dtype | None = torch.float16) -> None:
        """Write the checkpoint folder; weights in `dtype`, statistics in full precision."""
        weights = {
            key: value.to(dtype or value.dtype) if key.startswith("parts.") else value
            for key, value in self.state_dict().items()
        }
        checkpoint.save(folder, config=self.config, weights=weights, card=card)


def _all(x: Tensor) -> Tensor:
    return torch.ones(x.shape[0], dtype=torch.bool, device=x.device)
