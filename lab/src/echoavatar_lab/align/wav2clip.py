"""The audio network of Wav2CLIP, which the paper's retrieval table compares with BEATs; weights named as published.

Wu et al., "Wav2CLIP: Learning Robust Audio Representations from CLIP". A ResNet-18 over the log power spectrogram of
audio at 16 kHz. The published model averages over the whole clip; here states are kept in time. Its projection to
CLIP's space is not read, since the reward learns its own.
"""

from collections.abc import Mapping
from typing import Self

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.errors import CheckpointError

SPECTRUM, STEP = 512, 353  # samples of a frame, and from one to the next
QUIET = 1e-7
STAGES = 4
PREFIX = "audio_encoder."


class Wav2ClipConfig(Config):
    """Model sizes; the defaults are the published model's."""

    width: int = Field(default=64, gt=0, description="channels of the first stage; each further stage doubles them")
    blocks: int = Field(default=2, gt=0, description="residual blocks a stage")


class Block(nn.Module):
    """Two 3 x 3 convolutions with a residual connection."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))

    def forward(self, x: Float[Tensor, "b c f t"]) -> Float[Tensor, "b d g u"]:
        """Output of one block."""
        y = self.bn2(self.conv2(F.relu(self.bn1(self.conv1(x)))))
        out: Tensor = F.relu(y + self.downsample(x))
        return out


class Wav2Clip(nn.Module):
    """Audio at 16 kHz in, one state every 0.7 s out."""

    def __init__(self, config: Wav2ClipConfig) -> None:
        super().__init__()
        self.config = config
        self.conv1 = nn.Conv2d(1, config.width, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(config.width)
        inputs = config.width
        for stage in range(STAGES):
            outputs = config.width << stage
            blocks = [Block(inputs, outputs, 1 if stage == 0 else 2)]
            blocks += [Block(outputs, outputs, 1) for _ in range(config.blocks - 1)]
            setattr(self, f"layer{stage + 1}", nn.Sequential(*blocks))
            inputs = outputs

    @property
    def width(self) -> int:
        """Channels of a state."""
        return self.config.width << (STAGES - 1)

    def forward(self, wave: Float[Tensor, "b s"]) -> Float[Tensor, "b t c"]:
        """States in time, averaged over frequencies."""
        x = F.relu(self.bn1(self.conv1(spectrogram(wave)[:, None])))
        x = F.max_pool2d(x, 3, stride=2, padding=1)
        for stage in range(STAGES):
            x = getattr(self, f"layer{stage + 1}")(x)
        states: Tensor = x.mean(2).transpose(1, 2)
        return states

    @classmethod
    def from_published(cls, tensors: Mapping[str, Tensor]) -> Self:
        """Build from the tensors under `state_dict` in a published file; sizes follow from their shapes.

        Raises:
            CheckpointError: the tensors belong to another model.
        """
        kept = {
            name.removeprefix(PREFIX): value
            for name, value in tensors.items()
            if name.startswith(PREFIX) and not name.startswith((f"{PREFIX}spectrogram.", f"{PREFIX}fc."))
        }
        try:
            blocks = 1 + max(int(name.split(".")[1]) for name in kept if name.startswith("layer1."))
            model = cls(Wav2ClipConfig(width=kept["conv1.weight"].shape[0], blocks=blocks))
            model.load_state_dict(kept)
        except (KeyError, ValueError, RuntimeError) as error:
            reason = str(error).split("\n")[-1].strip()[:160]
            raise CheckpointError(f"these are not Wav2CLIP weights ({reason}); use its ResNet_CX.ckpt") from error
        return model.eval()


def spectrogram(wave: Float[Tensor, "b s"]) -> Float[Tensor, "b 257 t"]:
    """Log power, normalised to mean 0 and deviation 1 over each clip.

    The published code normalises over the whole batch; here the result does not depend on the other clips in it.
    """
    window = torch.hann_window(SPECTRUM, device=wave.device)
    spectrum = torch.stft(wave, SPECTRUM, STEP, window=window, return_complex=True)
    logs = (spectrum.abs().square() + QUIET).log()
    mean, deviation = logs.mean((1, 2), keepdim=True), logs.std((1, 2), keepdim=True)
    return (logs - mean) / (deviation + 1e-9)
