"""The flow-matching head: from noise to a face in three steps, under a condition.

Paper, Face Animation Generator: "flow matching diffusion head with 3 MLP blocks using AdaLN conditioning". As in the
release the network predicts the clean face, not the velocity.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from echoavatar.models.face.noise import euler_levels
from echoavatar_lab.nn.blocks import Mlp

HEAD_EPSILON = 1e-6  # of the norms inside the blocks


Schedule = list[tuple[Tensor, float, float]]  # of each Euler step: steering by time, noise level before and after


class FlowHead(nn.Module):
    """Faces (normalised) from noise. Each block: x + gate * MLP(norm(x) * scale + shift).

    `split` is the release's form of a block: two such halves, the first steered by the time, the second by the
    condition. Otherwise (ours, half the cost) one, steered by the sum of both.
    """

    def __init__(self, *, channels: int, condition: int, width: int, blocks: int, split: bool) -> None:
        super().__init__()
        self.width, self.split = width, split
        self.noisy_proj = nn.Linear(channels, width)
        self.condition_proj = nn.Linear(condition, width)
        self.time_in = nn.Linear(width, width)
        self.time_out = nn.Linear(width, width)
        self.by_condition = nn.Linear(width, blocks * 3 * width)  # of all blocks: shift, scale, gate
        if split:
            self.by_time = nn.Linear(width, blocks * 3 * width)
        halves = 2 * blocks if split else blocks
        self.mlps = nn.ModuleList(Mlp(inputs=width, hidden=4 * width, outputs=width) for _ in range(halves))
        self.output_norm = nn.LayerNorm(width)
        self.output_proj = nn.Linear(width, channels)

    def forward(
        self, noisy: Float[Tensor, "*b c"], times: Int[Tensor, "*b"], condition: Float[Tensor, "*b d"]
    ) -> Float[Tensor, "*b c"]:
        """The clean face that the network predicts."""
        return self.clean(noisy, self.steer(self.steer_time(times), self.condition_proj(condition)))

    def clean(self, noisy: Float[Tensor, "*#b c"], steering: Float[Tensor, "*#b n 3 w"]) -> Float[Tensor, "*b c"]:
        """`forward`, given the steering of each MLP."""
        x = F.linear(noisy, self.noisy_proj.weight, self.noisy_proj.bias)
        for mlp, steer in zip(self.mlps, steering.unbind(-3), strict=True):
            shift, scale, gate = steer.unbind(-2)
            bent = torch.addcmul(shift, F.layer_norm(x, (self.width,), eps=HEAD_EPSILON), scale)
            x = torch.addcmul(x, gate, mlp(bent))
        y: Tensor = self.output_proj(self.output_norm(x))
        return y

    def steer_time(self, times: Int[Tensor, "*b"]) -> Float[Tensor, "*b e"]:
        """The part of the steering that depends on the time alone; a stream computes it once per chunk."""
        embedded = self.embed_time(times)
        return self.by_time(F.silu(embedded)) if self.split else embedded

    def steer(self, time: Float[Tensor, "*#b e"], condition: Float[Tensor, "*#b w"]) -> Float[Tensor, "*b n 3 w"]:
        """Shift, scale (around 1) and gate of each MLP."""
        around_one = self.by_condition.bias.view(-1, 3, self.width) + self._scales()
        bent = F.silu(condition if self.split else time + condition)
        steering = F.linear(bent, self.by_condition.weight, around_one.flatten())
        steering = steering.view(*steering.shape[:-1], -1, 3, self.width)
        if self.split:
            of_time = time.view(*time.shape[:-1], -1, 3, self.width) + self._scales()
            steering = torch.stack([of_time + 0 * steering, steering + 0 * of_time], -3).flatten(-4, -3)
        return steering

    def _scales(self) -> Float[Tensor, "3 1"]:
        """1 for the scale; it is learned around that."""
        return self.time_in.weight.new_tensor([0.0, 1.0, 0.0])[:, None]

    def embed_time(self, times: Int[Tensor, "*b"]) -> Float[Tensor, "*b c"]:
        """Sinusoids through a small MLP."""
        y: Tensor = self.time_out(F.silu(self.time_in(self.sinusoids(times))))
        return y

    def sinusoids(self, times: Int[Tensor, "*b"]) -> Float[Tensor, "*b c"]:
        """Cosines, then sines, of 10000^(-i / half) times the (whole) time."""
        half = self.width // 2
        rates = torch.exp(-math.log(10_000) * torch.arange(half, device=times.device) / half)
        angles = times[..., None].to(rates.dtype) * rates
        return torch.cat([angles.cos(), angles.sin()], -1).to(self.time_in.weight)

    def schedule(self, steps: int) -> Schedule:
        """The Euler steps."""
        times, levels = euler_levels(steps)
        steering = self.steer_time(torch.tensor([int(time) for time in times], device=self.time_in.weight.device))
        return [(steering[i], levels[i], levels[i + 1]) for i in range(steps)]

    def sample(
        self, condition: Float[Tensor, "b 2 d"], noise: Float[Tensor, "b c"], schedule: Schedule, *, guidance: float
    ) -> Float[Tensor, "b c"]:
        """From noise to a face. Axis 1 of `condition`: without sound, with sound (classifier-free guidance)."""
        times = torch.stack([time for time, _, _ in schedule])[:, None, None]
        steering = self.steer(times, self.condition_proj(condition)).unbind()
        x = noise
        for steer, (_, level, following) in zip(steering, schedule, strict=True):
            without, with_sound = self.clean(x[:, None], steer).unbind(1)
            face = torch.lerp(without, with_sound, guidance)
            x = torch.lerp(x, face, (level - following) / (level + 1e-9))
        return x
