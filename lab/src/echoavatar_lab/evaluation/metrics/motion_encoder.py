"""Our own extractor for FID on the unified rig: a small convolutional autoencoder of motion, and its input.

The paper neither describes nor releases its extractor for ZeroEGGS and Motorica, so our FID values cannot be compared
with its tables, only with each other. One latent stands for 8 frames (a chunk) and sees about two seconds around them.
Latents are scaled to unit deviation on the training motion: a FID of 1 is a shift of the mean by one such deviation.

Where a clip faces or stands must not count as a difference between motions, so heading and place are left out of the
input; turning and travelling are kept. Per frame: 6D rotations of all joints with the hips facing +Z, the root's step
sideways and forwards (m/s), its turning speed (rad/s), its height (m).
"""

import math
from collections.abc import Mapping
from importlib.resources import as_file, files
from pathlib import Path

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.checkpoint import Checkpointed
from echoavatar_lab.kinematics import matrix_from_quaternion, matrix_to_6d

from .positions import heading, turn_about_up

TRAVEL = 4


def motion_features(rotations: Float[Tensor, "t j 4"], root: Float[Tensor, "t 3"]) -> Float[Tensor, "t c"]:
    """Features of a clip at 30 fps, 6 j + 4 a frame; the first frame repeats the second one's travel."""
    matrices = matrix_from_quaternion(rotations.float())
    yaw = heading(matrices[:, 0])
    back = turn_about_up(yaw)
    matrices = torch.cat([(back @ matrices[:, 0])[:, None], matrices[:, 1:]], 1)
    step = torch.zeros_like(root, dtype=torch.float32)
    turn = torch.zeros(len(root))
    if len(root) > 1:
        step[1:] = (back[:-1] @ root.float().diff(dim=0)[..., None])[..., 0]
        turn[1:] = (yaw.diff() + math.pi).remainder(2 * math.pi) - math.pi
        step[0], turn[0] = step[1], turn[1]
    travel = torch.stack([step[:, 0], step[:, 2], turn], -1) * FRAME_RATE_HZ
    return torch.cat([matrix_to_6d(matrices).flatten(1), travel, root[:, 1:2].float()], -1)


def feature_count(joints: int) -> int:
    """Values a frame: 316 for our rig."""
    return 6 * joints + TRAVEL


_MIN_SPREAD = 0.02  # of a feature: what hardly moves in the training motion must not be amplified


class MotionEncoderConfig(Config):
    """Model sizes."""

    features: int = Field(default=feature_count(HUMANOID.joints), gt=0, description="values a frame")
    width: int = Field(default=64, gt=0, description="channels of the hidden layers")
    latent: int = Field(default=48, gt=0, description="size of a latent, the features of FID")
    halvings: int = Field(default=3, gt=0, le=16, description="times that the frame rate is halved")


class _Block(nn.Module):
    """Two convolutions with a residual connection."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.inner = nn.Sequential(
            nn.GELU(), nn.Conv1d(width, width, 3, padding=1), nn.GELU(), nn.Conv1d(width, width, 3, padding=1)
        )

    def forward(self, x: Float[Tensor, "b c t"]) -> Float[Tensor, "b c t"]:
        y: Tensor = x + self.inner(x)
        return y


class MotionEncoder(Checkpointed):
    """Autoencoder of motion; FID is computed on `features`. Its weights are saved in half precision."""

    config_type = MotionEncoderConfig

    feature_mean: Tensor
    feature_std: Tensor
    latent_mean: Tensor
    latent_std: Tensor

    def __init__(self, config: MotionEncoderConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        down: list[nn.Module] = [nn.Conv1d(config.features, width, 3, padding=1)]
        up: list[nn.Module] = [nn.Conv1d(config.latent, width, 3, padding=1)]
        for _ in range(config.halvings):
            down += [_Block(width), nn.Conv1d(width, width, 4, 2, 1)]
            up += [_Block(width), nn.Upsample(scale_factor=2), nn.Conv1d(width, width, 3, padding=1)]
        self.encoder = nn.Sequential(*down, nn.GELU(), nn.Conv1d(width, config.latent, 1))
        self.decoder = nn.Sequential(*up, nn.GELU(), nn.Conv1d(width, config.features, 3, padding=1))
        for name, size in (("feature", config.features), ("latent", config.latent)):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_std", torch.ones(size))

    @property
    def frames_per_latent(self) -> int:
        """Frames for one latent."""
        return int(2**self.config.halvings)

    def set_feature_statistics(self, mean: Float[Tensor, " c"], std: Float[Tensor, " c"]) -> None:
        """Set the statistics of the training motion's features."""
        self.feature_mean.copy_(mean)
        self.feature_std.copy_(std.clamp_min(_MIN_SPREAD))

    @torch.no_grad()
    def set_latent_statistics(self, clips: list[Float[Tensor, "_ c"]]) -> None:
        """Scale latents to unit deviation on these clips."""
        self.latent_mean.zero_()
        self.latent_std.fill_(1)
        latents = torch.cat([self.features(clip) for clip in clips])
        self.latent_mean.copy_(latents.mean(0))
        self.latent_std.copy_(latents.std(0).clamp_min(1e-3))

    def forward(self, features: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """Encode and decode normalised features; t must be a multiple of `frames_per_latent`."""
        y: Tensor = self.decoder(self.encoder(features.transpose(1, 2)))
        return y.transpose(1, 2)

    def normalize(self, features: Float[Tensor, "*n c"]) -> Float[Tensor, "*n c"]:
        """Zero mean and unit deviation on the training motion."""
        return (features - self.feature_mean) / self.feature_std

    @torch.no_grad()
    def features(self, clip: Float[Tensor, "t c"]) -> Float[Tensor, "n d"]:
        """Latents of one clip of `motion_features`; frames after the last whole latent are cut off.

        Raises MotionError if the clip is shorter than one latent, or of another rig.
        """
        whole = len(clip) - len(clip) % self.frames_per_latent
        if not whole or clip.shape[1] != self.config.features:
            raise MotionError(
                f"the extractor reads {self.config.features} values a frame, {self.frames_per_latent} frames or more;"
                f" got {tuple(clip.shape)}; retarget the clip, or use a longer one"
            )
        latents: Tensor = self.encoder(self.normalize(clip[None, :whole]).transpose(1, 2))[0].T
        return (latents - self.latent_mean) / self.latent_std

    def save(self, folder: Path, card: Mapping[str, object], *, dtype: torch.dtype | None = torch.float16) -> None:
        """See `Checkpointed.save`."""
        super().save(folder, card, dtype=dtype)


def load_shipped() -> MotionEncoder:
    """The extractor shipped with the package, trained on rehearsal motion."""
    with as_file(files("echoavatar_lab") / "bundles" / "fid_encoder") as folder:
        return MotionEncoder.load(folder)
