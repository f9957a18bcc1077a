"""The whole body's tokenizer: one causal RVQ-VAE per body part, statistics and skeleton in one checkpoint.

Paper, Motion Tokenizer: anatomically partitioned tokenisation, separate codebooks for lower body, upper body, hands.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Self, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from pydantic import Field, model_validator
from torch import Tensor, nn

from echoavatar import checkpoint
from echoavatar.config import Config
from echoavatar.motion.kinematics import FeatureStatistics, Skeleton, SkeletonConfig, part_sizes, split_parts
from echoavatar.nn import Checkpointed, StreamState
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN

from .model import DecoderState, EncoderState, MotionTokenizer, MotionTokenizerConfig

PIECE_TOKENS = 60  # whole clips go through the streams in pieces of this length, so memory does not grow
PartState = TypeVar("PartState", EncoderState, DecoderState)


class BodyTokenizerConfig(Config):
    """A skeleton and the sizes of each part's tokenizer."""

    skeleton: SkeletonConfig = Field(description="the rig whose features are tokenised")
    parts: dict[str, MotionTokenizerConfig] = Field(description="sizes of each part, in the skeleton's order")

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        sizes = part_sizes(Skeleton(self.skeleton))
        if {name: part.features for name, part in self.parts.items()} != sizes:
            raise ValueError(f"the parts must be those of the skeleton with their features, {sizes}")
        if len({(part.layers, part.codes) for part in self.parts.values()}) != 1:
            raise ValueError("all parts must have the same number of layers and codes")
        return self

    @property
    def layers(self) -> int:
        """RVQ layers Q of every part."""
        return next(iter(self.parts.values())).layers

    @property
    def codes(self) -> int:
        """Codes per layer K of every part."""
        return next(iter(self.parts.values())).codes


def body_config(skeleton: Skeleton, template: MotionTokenizerConfig) -> BodyTokenizerConfig:
    """The same sizes for every part; `template.features` is replaced."""
    return BodyTokenizerConfig(
        skeleton=skeleton.config,
        parts={name: template.model_copy(update={"features": size}) for name, size in part_sizes(skeleton).items()},
    )


def as_one_part(skeleton: Skeleton) -> Skeleton:
    """The same rig as one part, with which the paper compares its body parts. Features change their order."""
    joints = {"body": tuple(sorted(skeleton.feature_joints))}
    return Skeleton(skeleton.config.model_copy(update={"parts": joints}))


@dataclass
class BodyState(StreamState, Generic[PartState]):
    """Encoder or decoder streams of all parts."""

    parts: list[PartState]


class BodyTokenizer(Checkpointed):
    """Motion features (315 channels for our rig) <-> codes of every part and layer, four frames a token."""

    config_type = BodyTokenizerConfig
    config: BodyTokenizerConfig
    mean: Tensor
    std: Tensor
    varies: Tensor

    def __init__(self, config: BodyTokenizerConfig) -> None:
        super().__init__()
        self.config = config
        self.skeleton = Skeleton(config.skeleton)
        size = sum(part.features for part in config.parts.values())
        self.parts = nn.ModuleDict({name: MotionTokenizer(part) for name, part in config.parts.items()})
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))
        self.register_buffer("varies", torch.ones(size, dtype=torch.bool))

    @property
    def statistics(self) -> FeatureStatistics:
        """Normalisation of the features."""
        return FeatureStatistics(self.mean, self.std, self.varies)

    @torch.no_grad()
    def set_statistics(self, statistics: FeatureStatistics) -> None:
        """Copy the corpus's statistics in."""
        for own, value in zip(self.statistics, statistics, strict=True):
            own.copy_(value)

    def tokenizers(self) -> dict[str, MotionTokenizer]:
        """The parts' tokenizers, in the order of the codes' part axis."""
        return {name: part for name, part in self.parts.items() if isinstance(part, MotionTokenizer)}

    def codebooks(self) -> Float[Tensor, "p q K c"]:
        """The code vectors of every part and layer."""
        parts = [torch.stack([book.codebook for book in part.quantizer.books()]) for part in self.tokenizers().values()]
        return torch.stack(parts)

    @torch.no_grad()
    def encode(self, features: Float[Tensor, "b t c"], patience: float = 0.0) -> Int[Tensor, "b n p q"]:
        """Codes of whole clips; the number of frames must be a multiple of four.

        `patience` prefers codes that stay (`quantize.steady`): what a generator is trained on.
        """
        active, codes = _all(features), []
        parts = split_parts(self.skeleton, self.statistics.normalize(features))
        for name, tokenizer in self.tokenizers().items():
            state = tokenizer.init_encoder(features.shape[0])
            pieces = torch.split(parts[name], PIECE_TOKENS * FRAMES_PER_MOTION_TOKEN, 1)
            latents = torch.cat([tokenizer.latents_step(piece, state, active) for piece in pieces], 1)
            codes.append(tokenizer.quantizer.encode(latents, patience))
        return torch.stack(codes, 2)

    @torch.no_grad()
    def decode(self, codes: Int[Tensor, "b n p q"]) -> Float[Tensor, "b t c"]:
        """Features (not normalised) of whole clips; trailing layers may be missing or -1."""
        state, active = self.init_decoder(codes.shape[0]), _all(codes)
        pieces = torch.split(codes, PIECE_TOKENS, 1)
        return torch.cat([self.decode_step(piece, state, active) for piece in pieces], 1)

    def init_encoder(self, rows: int) -> BodyState[EncoderState]:
        """Encoder streams that have seen nothing."""
        return BodyState([part.init_encoder(rows) for part in self.tokenizers().values()])

    def init_decoder(self, rows: int) -> BodyState[DecoderState]:
        """Decoder streams that have seen nothing."""
        return BodyState([part.init_decoder(rows) for part in self.tokenizers().values()])

    def encode_step(
        self, features: Float[Tensor, "b t c"], state: BodyState[EncoderState], active: Bool[Tensor, " b"]
    ) -> Int[Tensor, "b n p q"]:
        """Codes of the next 4k frames of running clips."""
        parts = split_parts(self.skeleton, self.statistics.normalize(features))
        return torch.stack(
            [
                tokenizer.encode_step(parts[name], part, active)
                for (name, tokenizer), part in zip(self.tokenizers().items(), state.parts, strict=True)
            ],
            2,
        )

    def decode_step(
        self, codes: Int[Tensor, "b n p q"], state: BodyState[DecoderState], active: Bool[Tensor, " b"]
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
