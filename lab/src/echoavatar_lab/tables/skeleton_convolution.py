"""EMAGE's autoencoder with convolutions along a skeleton's bones; EMAGE, MECo and the paper compute FID on its latents.

The input is 6D rotations of SMPL-X's 55 joints at 30 fps, (t, 330). Every layer halves the frame rate and mixes each
bone with those at most two bones away; the first two layers merge bones in pairs (55, 35, 20). Latents are (t / 16,
240). Module names are those of the released weights without their `module.` prefix, so that a user's own copy loads
from safetensors; we may not ship them. Clips are cut to a multiple of 32 frames and encoded whole. Features are the
encoder's output, before the variational heads. MECo replaces jaw and eyes by the true ones first.

Bones are the edges of a graph. Edge 0 is virtual: it is attached to the root and carries the root's own rotation. Edge
j is the bone from the parent of joint j to joint j. Edges and joints thus have the same numbers, and a frame's
rotations are the edges' channels.

Users without a copy of EMAGE's weights train an extractor of their own: the same network and input, trained to
reconstruct motion from the encoder's output. EMAGE's is variational and saw more data, so FID values of the two cannot
be compared.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from pydantic import Field, model_validator
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.errors import MotionError
from echoavatar.motion.formats.smpl import skeleton
from echoavatar.stored import read_config
from echoavatar_lab import checkpoint
from echoavatar_lab.evaluation.metrics.motion_encoder_train import cut_windows
from echoavatar_lab.kinematics import matrix_from_quaternion
from echoavatar_lab.training import Loss, TrainingConfig, TrainingTask, seeded

Edge = tuple[int, int]

SMPLX_PARENTS = skeleton().parents
"""Parents of SMPL-X's 55 joints: body, jaw and eyes, left fingers, right fingers."""


def skeleton_edges(parents: Sequence[int]) -> list[Edge]:
    """All bones of a skeleton whose joint 0 is the root; the virtual edge comes first."""
    return [(0, len(parents)), *((parents[joint], joint) for joint in range(1, len(parents)))]


def neighbours(edges: Sequence[Edge], reach: int) -> Bool[np.ndarray, "e e"]:
    """Which edges are at most `reach` apart; edges that share a joint are 1 apart."""
    ends = np.array(edges)
    touching = (ends[:, None, :, None] == ends[None, :, None, :]).any((2, 3))
    near = np.eye(len(edges), dtype=bool)
    for _ in range(reach):
        near = (near.astype(int) @ touching.astype(int)) > 0
    return near


def merged(edges: Sequence[Edge]) -> tuple[list[list[int]], list[Edge]]:
    """Groups of one or two edges to merge, and the merged edges.

    Unbranched chains of bones are paired from their far end; in an odd chain the first bone stays alone. The virtual
    edge comes first and stays as it is; the order is depth first from the root.
    """
    leaving: dict[int, list[int]] = {}
    for index, (start, _) in enumerate(edges):
        if index:
            leaving.setdefault(start, []).append(index)
    groups = [[0]]

    def walk(first: int) -> None:
        chain = [first]
        while len(after := leaving.get(edges[chain[-1]][1], [])) == 1:
            chain.append(after[0])
        odd = len(chain) % 2
        groups.extend([[chain[0]]] if odd else [])
        groups.extend([chain[k], chain[k + 1]] for k in range(odd, len(chain), 2))
        for branch in after:
            walk(branch)

    for edge in leaving.get(0, []):
        walk(edge)
    return groups, [(edges[group[0]][0], edges[group[-1]][1]) for group in groups]


def averaging(groups: Sequence[Sequence[int]], edges: int, channels: int) -> Float[np.ndarray, "out in"]:
    """Matrix that averages the channels over each group of edges."""
    matrix = np.zeros((len(groups), edges), np.float32)
    for row, group in enumerate(groups):
        matrix[row, list(group)] = 1 / len(group)
    return np.kron(matrix, np.eye(channels, dtype=np.float32))


CLIP_MULTIPLE = 32
_PREFIX = "module."
_WIDEST = 8192  # a mask has its square in numbers


class SkeletonConvolutionConfig(Config):
    """Model sizes; the defaults are EMAGE's."""

    parents: tuple[int, ...] = Field(default=SMPLX_PARENTS, description="parent of each joint, -1 for the root")
    channels: tuple[int, ...] = Field(
        default=(6, 6, 6, 12, 12), description="channels of a bone before and after each layer"
    )
    reach: int = Field(default=2, ge=0, le=64, description="distance between bones that are mixed")
    groups: int = Field(default=10, gt=0, description="groups of the normalisation")

    @model_validator(mode="after")
    def _masks_fit_into_memory(self) -> Self:
        if len(self.parents) * max(self.channels, default=0) > _WIDEST:
            raise ValueError(f"parents times channels may be {_WIDEST} at most")
        return self


def extractor_input(rotations: Float[Tensor, "t j 4"]) -> Float[Tensor, "t c"]:
    """The extractor's input: the first two rows of each rotation matrix (our own features use columns)."""
    return matrix_from_quaternion(rotations.float())[..., :2, :].flatten(1)


class _MaskedConv(nn.Conv1d):
    """Convolution whose weights are zero between bones that are not neighbours."""

    def __init__(self, mask: Tensor, *, size: int, stride: int, padding: int) -> None:
        super().__init__(mask.shape[1], mask.shape[0], size, stride, padding)
        self.mask = nn.Parameter(mask[:, :, None].repeat(1, 1, size), requires_grad=False)

    def forward(self, x: Float[Tensor, "b c t"]) -> Float[Tensor, "b d n"]:
        return F.conv1d(x, self.weight * self.mask, self.bias, self.stride, self.padding)


class _Merge(nn.Module):
    """Replaces the bones of a group by their mean."""

    def __init__(self, matrix: Tensor) -> None:
        super().__init__()
        self.weight = nn.Parameter(matrix, requires_grad=False)

    def forward(self, x: Float[Tensor, "b c t"]) -> Float[Tensor, "b d t"]:
        return self.weight @ x


class _Layer(nn.Module):
    """Masked convolution with a masked shortcut, then merging and tanh; halves the frame rate."""

    def __init__(self, edges: Sequence[Edge], before: int, after: int, config: SkeletonConvolutionConfig) -> None:
        super().__init__()
        near = torch.from_numpy(neighbours(edges, config.reach)).float()
        mask = torch.kron(near, torch.ones(after, before))
        self.residual = nn.Sequential(
            _MaskedConv(mask, size=4, stride=2, padding=1), nn.GroupNorm(config.groups, after * len(edges))
        )
        self.shortcut = _MaskedConv(mask, size=1, stride=2, padding=0)
        groups, self.edges = merged(edges)
        is_merging = len(groups) < len(edges)
        matrix = torch.from_numpy(averaging(groups, len(edges), after))
        self.common = nn.Sequential(*([_Merge(matrix)] if is_merging else []), nn.Tanh())

    def forward(self, x: Float[Tensor, "b c t"]) -> Float[Tensor, "b d n"]:
        y: Tensor = self.common(self.residual(x) + self.shortcut(x))
        return y


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.model = nn.Sequential(
            nn.Conv1d(width, width, 3, 1, 1), nn.LeakyReLU(0.2), nn.Conv1d(width, width, 3, 1, 1)
        )

    def forward(self, x: Float[Tensor, "b c t"]) -> Float[Tensor, "b c t"]:
        y: Tensor = self.model(x) + x
        return y


class SkeletonConvolution(checkpoint.Checkpointed):
    """Variational autoencoder; FID uses the encoder's output, the variational heads are unused."""

    config_type = SkeletonConvolutionConfig

    def __init__(self, config: SkeletonConvolutionConfig) -> None:
        super().__init__()
        self.config = config
        edges, layers = skeleton_edges(config.parents), []
        for before, after in pairwise(config.channels):
            layers.append(nn.Sequential(_Layer(edges, before, after, config)))
            edges = merged(edges)[1]
        self.encoder = nn.Module()
        self.encoder.layers = nn.ModuleList(layers)
        width, features = config.channels[-1] * len(edges), config.channels[0] * len(config.parents)
        self.fc_mu, self.fc_logvar = nn.Linear(width, width), nn.Linear(width, width)
        self.decoder = nn.Module()
        self.decoder.main = nn.Sequential(*_decoder(width, features, depth=len(layers)))

    @property
    def frames_per_latent(self) -> int:
        """Frames for one latent."""
        return int(2 ** len(self.config.channels[1:]))

    def encode(self, rotations: Float[Tensor, "b t c"]) -> Float[Tensor, "b n d"]:
        """Latents of whole clips of 6D rotations.

        Raises:
            MotionError: the number of frames is not a multiple of `frames_per_latent`, or the joints are others.
        """
        frames, size = rotations.shape[1:]
        wanted = self.config.channels[0] * len(self.config.parents)
        if size != wanted or frames % self.frames_per_latent or not frames:
            raise MotionError(
                f"the extractor reads {wanted} values a frame and a multiple of {self.frames_per_latent} frames;"
                f" got {frames} frames of {size}; cut the clip"
            )
        x = rotations.transpose(1, 2)
        for layer in self.encoder.layers:  # type: ignore[union-attr]
            x = layer(x)
        return x.transpose(1, 2)

    def decode(self, latents: Float[Tensor, "b n d"]) -> Float[Tensor, "b t c"]:
        """6D rotations decoded from latents."""
        y: Tensor = self.decoder.main(latents.transpose(1, 2))  # type: ignore[operator]
        return y.transpose(1, 2)

    @torch.no_grad()
    def features(self, rotations: Float[Tensor, "t c"]) -> Float[Tensor, "n d"]:
        """Latents of one clip for FID; frames after the last multiple of 32 are cut off, as in EMAGE."""
        whole = len(rotations) - len(rotations) % CLIP_MULTIPLE
        return self.encode(rotations[None, :whole])[0]

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read `config.json` and `model.safetensors`; names may have the released files' prefix `module.`."""
        config = read_config(folder, SkeletonConvolutionConfig)
        weights = {key.removeprefix(_PREFIX): value for key, value in checkpoint.read_weights(folder).items()}
        return checkpoint.build_for(weights, partial(cls, config), origin=str(folder)).eval()


def _decoder(width: int, features: int, *, depth: int) -> list[nn.Module]:
    parts: list[nn.Module] = [_Residual(width), _Residual(width)]
    for layer in range(depth):
        out = features if layer == depth - 1 else width
        parts += [nn.Upsample(scale_factor=2), nn.Conv1d(width, out, 3, 1, 1), nn.LeakyReLU(0.2)]
    return [*parts, nn.Conv1d(features, features, 3, 1, 1)]


class SkeletonConvolutionTraining(TrainingConfig):
    """How the extractor is trained."""

    steps: int = Field(default=2000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=16, gt=0, description="windows per step")
    frames: int = Field(default=64, gt=0, multiple_of=CLIP_MULTIPLE, description="frames of a window, at 30 per second")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule")
    warmup: int = Field(default=50, ge=0, description="steps of linear warm-up")
    speed_weight: float = Field(default=1.0, ge=0, description="weight of the error in frame differences")


class SkeletonConvolutionTask(TrainingTask[Tensor]):
    """The training task of the extractor."""

    kind = "beat2-extractor"
    config: SkeletonConvolutionTraining

    def __init__(
        self,
        config: SkeletonConvolutionConfig,
        training: SkeletonConvolutionTraining,
        clips: Sequence[Float[Tensor, "_ c"]],
        *,
        card: Mapping[str, object] | None = None,
    ) -> None:
        """Raises MotionError when no clip is as long as a window."""
        self.clips = [clip for clip in clips if len(clip) >= training.frames]
        if not self.clips:
            raise MotionError(f"no clip has {training.frames} frames; give a set of longer clips")
        with seeded(training.seed):
            self.model = SkeletonConvolution(config)
        for head in (self.model.fc_mu, self.model.fc_logvar):
            head.requires_grad_(False)  # FID does not use them
        super().__init__(training, {"model": self.model}, card)

    def draw(self, step: int) -> Float[Tensor, "b t c"]:
        """See `TrainingTask.draw`."""
        return cut_windows(self.clips, self.config.frames, self.config.batch, self.config.noise(step))

    def loss(self, batch: Float[Tensor, "b t c"], step: int) -> Loss:
        """Error of rotations and of their frame differences."""
        error = self.model.decode(self.model.encode(batch)) - batch
        places = F.smooth_l1_loss(error, torch.zeros_like(error))
        return Loss(places + self.config.speed_weight * error.diff(dim=1).abs().mean(), {"places": places})
