"""GRPO and PPO: learn from continuations that the policy sampled itself and reward functions judged.

GRPO compares the continuations of a prompt with each other (paper, Reward-Guided Optimization). PPO has a value head,
one continuation a prompt and a critic learning rate of 1e-5 (paper, Comparison with PPO).

Losses are in nats. All log-probabilities are those of the constrained distribution that codes are sampled from
(`policy`). Continuations have one fixed length, so a mean over codes weights them equally and needs neither mask nor
end token.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from echoavatar.errors import CheckpointError
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.training import Loss, adamw

from .prompts import Prompt, PromptBatch, PromptSampler, batch_of
from .trainer import PolicyTask, rollout_seeds

SPREAD_FLOOR = 1e-4  # added to a group's deviation, as in TRL: a group of equal rewards has no advantages


class RolloutBatch(NamedTuple):
    """Continuations, one a row, with the tensors that an optimiser step needs."""

    prompts: PromptBatch
    codes: Int[Tensor, "r n p q"]
    advantages: Float[Tensor, "r n"]
    logged: Float[Tensor, "r m"]  # logged values of each continuation
    old: Float[Tensor, "r n k"] | None = None  # log-probabilities under the policy that sampled
    support: Bool[Tensor, "r n k K"] | None = None
    values: Float[Tensor, "r n"] | None = None  # the critic's predictions
    returns: Float[Tensor, "r n"] | None = None


class RolloutTask(PolicyTask[RolloutBatch]):
    """Samples continuations, has them judged, and keeps them for `epochs` steps.

    With several processes each one samples a share of the prompts; the results are then gathered.
    """

    def __init__(self, *args: Any, book: PromptSampler, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        has = self.policy.layout.motion_layers
        if self.config.layers > has:
            raise CheckpointError(f"layers is {self.config.layers}, the generator has {has}; 0 credits all of them")
        self._book = book
        self._rollout = self.policy.rollout if self.context.rollouts is None else self.context.rollouts(self.policy)
        self._kept: tuple[int, RolloutBatch] | None = None
        self._names: tuple[str, ...] = ()
        self._step = 0

    def draw(self, step: int) -> RolloutBatch:
        """The continuations of batch number `step` // `epochs`."""
        self._step, number = step, step // self.config.epochs
        if self._kept is None or self._kept[0] != number:
            self._kept = (number, self._sample(number))
        return self._kept[1]

    @abstractmethod
    def credit(
        self, tokens: Float[Tensor, "r n"], whole: Float[Tensor, " r"], values: Float[Tensor, "r n"] | None
    ) -> tuple[Float[Tensor, "r n"], Float[Tensor, "r n"] | None]:
        """Advantages of a whole batch, and returns if there is a critic, which predicted `values`.

        `tokens` and `whole` are the rewards by motion token and those of whole continuations.
        """

    def credited(self, advantages: Float[Tensor, "r n"]) -> Float[Tensor, "r n k"]:
        """An advantage for each code; 0 for the RVQ layers that rewards are not credited to (not in the paper).

        Coarse codes decide when a limb moves. For the many fine codes rewards of timing are mostly noise.
        """
        layout = self.policy.layout
        layers = torch.arange(layout.segments, device=advantages.device) % layout.motion_layers
        return advantages[:, :, None] * (layers < (self.config.layers or layout.motion_layers))

    @torch.no_grad()
    def _sample(self, number: int) -> RolloutBatch:
        training, device, gather = self.config, self.device, self.processes.gather
        drawn = self._with_own_past(self._book.draw(number, training.batch), number)
        group, share = training.group, len(drawn) // self.processes.count
        first = self.processes.rank * share
        mine = drawn[first : first + share]
        seeds = rollout_seeds(training, number, len(drawn) * group)[first * group : (first + share) * group].to(device)
        asked = batch_of(mine, str(device))
        codes = self._rollout(asked, group, seeds)
        rewards = self.judge(mine, codes)
        self._names = ("reward", *(f"rewards.{name}" for name in rewards.parts), "spread")
        tokens, whole, *columns = (
            gather(torch.from_numpy(part).to(device))
            for part in (rewards.tokens, rewards.whole, rewards.total, *rewards.parts.values())
        )
        spread = columns[0].view(-1, group).std(1, correction=0).repeat_interleave(group)
        is_scored_now = self.critic is not None or training.epochs > 1  # otherwise the step itself scores
        scored = self._scored(asked.repeated(group), codes) if is_scored_now else {}
        advantages, returns = self.credit(tokens.float(), whole.float(), scored.get("values"))
        logged = torch.stack([*columns, spread], 1).float()
        batch = batch_of(drawn, str(device)).repeated(group)
        return RolloutBatch(batch, gather(codes), advantages, logged, returns=returns, **scored)

    def _with_own_past(self, drawn: Sequence[Prompt], number: int) -> list[Prompt]:
        """The prompts, the last `own_past` chunks of their past made by the policy.

        After true motion a policy can read the time off the body; in a session it cannot.
        """
        tokens = self.config.own_past * MOTION_TOKENS_PER_CHUNK
        if not tokens:
            return list(drawn)
        past, device = batch_of(drawn, str(self.device)), self.device
        head = PromptBatch(past.audio[:, : self.config.past * AUDIO_FRAMES_PER_CHUNK], past.past[:, :-tokens])
        seeds = rollout_seeds(self.config, -1 - number, len(drawn)).to(device)
        made = torch.cat([head.past, self._rollout(head, 1, seeds)], 1).cpu().numpy()
        return [replace(prompt, past=own) for prompt, own in zip(drawn, made, strict=True)]

    def _scored(self, prompts: PromptBatch, codes: Int[Tensor, "r n p q"]) -> dict[str, Tensor]:
        """Scores of this process's continuations under the policy that sampled, gathered from all processes."""
        each = -(-len(codes) // self.config.accumulation)
        found: list[dict[str, Tensor]] = []
        for start in range(0, len(codes), each):
            at = slice(start, start + each)
            scores = self.policy.score(prompts.rows(at), codes[at])
            values = {} if self.critic is None else {"values": self.critic(scores.hidden)}
            found.append({"old": scores.log_probs, "support": scores.support.byte()} | values)
        columns = {name: self.processes.gather(torch.cat([one[name] for one in found])) for name in found[0]}
        return columns | {"support": columns["support"].bool()}

    def logged_means(self, batch: RolloutBatch) -> dict[str, Tensor]:
        """Means of the logged values over some rows."""
        return dict(zip(self._names, batch.logged.mean(0), strict=True))

    def state(self) -> Mapping[str, Tensor]:
        """The continuations, if the next step still uses them."""
        if self._kept is None or (self._step + 1) % self.config.epochs == 0:
            return {}
        made = self._kept[1]
        parts = made._asdict() | {"audio": made.prompts.audio, "past": made.prompts.past}
        tensors = {name: value for name, value in parts.items() if isinstance(value, Tensor) and name != "logged"}
        columns = {f"told.{at}.{name}": made.logged[:, at] for at, name in enumerate(self._names)}
        return tensors | columns | {"number": torch.tensor(self._kept[0])}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """See `TrainingTask.load_state`."""
        self._kept = None
        if not state:
            return
        columns = sorted((int(key.split(".")[1]), key) for key in state if key.startswith("told."))
        self._names = tuple(key.split(".", 2)[2] for _, key in columns)
        logged = torch.stack([state[key] for _, key in columns], 1)
        rest = {name: state[name] for name in RolloutBatch._fields if name in state}
        prompts = PromptBatch(state["audio"], state["past"])
        self._kept = (int(state["number"]), RolloutBatch(prompts, logged=logged, **rest))


class GrpoLoss(NamedTuple):
    """The loss and a diagnostic."""

    loss: Float[Tensor, ""]
    clipped: Float[Tensor, ""]  # share of codes whose ratio was clipped


def group_advantages(rewards: Float[Tensor, "b g"]) -> Float[Tensor, "b g"]:
    """Paper: (r_i - mu_G) / sigma_G of each group (spread with n - 1, plus 1e-4, as TRL)."""
    spread = rewards.std(1, keepdim=True) if rewards.shape[1] > 1 else torch.zeros_like(rewards)
    return (rewards - rewards.mean(1, keepdim=True)) / (spread + SPREAD_FLOOR)


def rewards_to_go(rewards: Float[Tensor, "... n"], discount: float) -> Float[Tensor, "... n"]:
    """The sum of each step's reward and the later ones, discounted by `discount` a step."""
    running, out = torch.zeros_like(rewards[..., 0]), []
    for step in reversed(rewards.unbind(-1)):
        running = step + discount * running
        out.append(running)
    return torch.stack(out[::-1], -1)


def timed_advantages(
    rewards: Float[Tensor, "b g n"], whole: Float[Tensor, "b g"], discount: float
) -> Float[Tensor, "b g n"]:
    """Advantages by motion token: rewards to go minus the group's mean at that time, divided by the group's deviation.

    `whole` is the part of the reward that belongs to no particular time; it counts for every code.

    Departs from the paper, which gives every code of a continuation the same advantage (`group_advantages` of summed
    rewards; the same as discount 1 with one reward at the end). A code affects only what follows, and after a second
    hardly anything, so most of the variance of the sum is noise to it.
    """
    to_go = rewards_to_go(rewards, discount) + whole[..., None]
    centred = to_go - to_go.mean(1, keepdim=True)
    if rewards.shape[1] < 2:
        return torch.zeros_like(centred)
    spread = (centred.square().sum((1, 2), keepdim=True) / ((rewards.shape[1] - 1) * rewards.shape[2])).sqrt()
    return centred / (spread + SPREAD_FLOOR)


def grpo_loss(
    *,
    policy: Float[Tensor, "b ..."],
    old: Float[Tensor, "b ..."],
    advantages: Float[Tensor, "b ..."],
    kl: Float[Tensor, "b ..."],
    clip: float,
    kl_weight: float,
) -> GrpoLoss:
    """Group-relative policy loss (paper, equation GRPO), averaged over codes.

    Departs from the equation: ratios are clipped for each code, as in DeepSeekMath and TRL (`loss_type="grpo"`).
    `advantages` broadcasts: one a row, or one a code. `kl` is that of each code, with its gradient.
    """
    surrogate, clipped = _surrogate(policy, old, advantages, clip)
    return GrpoLoss((kl_weight * kl - surrogate).mean(), clipped)


def _surrogate(
    policy: Float[Tensor, "b ..."], old: Float[Tensor, "b ..."], advantages: Float[Tensor, "b ..."], clip: float
) -> tuple[Float[Tensor, "b ..."], Float[Tensor, ""]]:
    """The clipped surrogate of each code, and the share of codes whose ratio was clipped."""
    ratio = (policy - old).exp()
    free, limited = ratio * advantages, ratio.clamp(1 - clip, 1 + clip) * advantages
    return torch.minimum(free, limited), (free > limited).float().mean()


class GrpoTask(RolloutTask):
    """Rollouts, rewards, advantages normalised within each group, one or several steps on them."""

    def credit(
        self, tokens: Float[Tensor, "r n"], whole: Float[Tensor, " r"], values: Float[Tensor, "r n"] | None
    ) -> tuple[Float[Tensor, "r n"], None]:
        """Advantages within each group; there is no critic, so no returns."""
        training = self.config
        grouped = (training.batch, training.group)
        if training.credit == "sequence":
            by_row = group_advantages((tokens.sum(1) + whole).view(grouped))
            return by_row.flatten()[:, None].expand_as(tokens), None
        timed = timed_advantages(tokens.view(*grouped, -1), whole.view(grouped), training.discount)
        return timed.flatten(0, 1), None

    def loss(self, batch: RolloutBatch, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        scores = self.policy.score(batch.prompts, batch.codes, batch.support)
        kl = self.divergence(scores, batch.prompts, batch.codes)
        found = grpo_loss(
            policy=scores.log_probs,
            old=scores.log_probs.detach() if batch.old is None else batch.old,
            advantages=self.credited(batch.advantages),
            kl=kl,
            clip=self.config.ratio_clip,
            kl_weight=self.config.kl_weight,
        )
        return Loss(found.loss, self.logged(self.logged_means(batch) | {"clipped": found.clipped}, kl, scores))


class PpoLoss(NamedTuple):
    """Losses of the policy and of its critic."""

    policy: Float[Tensor, ""]
    value: Float[Tensor, ""]
    clipped: Float[Tensor, ""]


def generalised_advantages(
    rewards: Float[Tensor, "b n"], values: Float[Tensor, "b n"], *, discount: float, decay: float
) -> tuple[Float[Tensor, "b n"], Float[Tensor, "b n"]]:
    """Generalised advantages by step, and the returns that the critic learns; nothing follows the last step."""
    following = torch.cat([values[:, 1:], torch.zeros_like(values[:, :1])], 1)
    surprise = rewards + discount * following - values
    advantages = rewards_to_go(surprise, discount * decay)
    return advantages, advantages + values


def ppo_loss(
    *,
    policy: Float[Tensor, "b ..."],
    old: Float[Tensor, "b ..."],
    advantages: Float[Tensor, "b ..."],
    values: Float[Tensor, "b m"],
    old_values: Float[Tensor, "b m"],
    returns: Float[Tensor, "b m"],
    clip: float,
) -> PpoLoss:
    """Clipped surrogate, and clipped value loss (half the larger squared error), each averaged."""
    surrogate, clipped = _surrogate(policy, old, advantages, clip)
    near = old_values + (values - old_values).clamp(-clip, clip)
    value = 0.5 * torch.maximum((values - returns).square(), (near - returns).square())
    return PpoLoss(-surrogate.mean(), value.mean(), clipped)


class ValueHead(nn.Module):
    """Predicts the return from the hidden state that predicts a motion token's first code; starts at zero.

    The state is detached, so the value error does not train the policy.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.value = nn.Linear(width, 1)
        nn.init.zeros_(self.value.weight)
        nn.init.zeros_(self.value.bias)

    def forward(self, hidden: Float[Tensor, "b n k c"]) -> Float[Tensor, "b n"]:
        """One value for each motion token."""
        values: Tensor = self.value(hidden[:, :, 0].detach().float())
        return values[..., 0].float()


class PpoTask(RolloutTask):
    """Clipped surrogate with generalised advantages; the reward of a whole continuation is spread over its tokens."""

    critic: ValueHead

    def __init__(self, generator: Generator, *args: Any, **kwargs: Any) -> None:
        super().__init__(generator, *args, critic=ValueHead(generator.config.read_width), **kwargs)

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """Adds an optimiser for the critic with its own learning rate."""
        critic = adamw([self.critic], self.config)
        for group in critic.param_groups:
            group["relative"] = self.config.critic_rate / self.config.learning_rate
        return [*super().optimisers(), critic]

    def credit(
        self, tokens: Float[Tensor, "r n"], whole: Float[Tensor, " r"], values: Float[Tensor, "r n"] | None
    ) -> tuple[Float[Tensor, "r n"], Float[Tensor, "r n"]]:
        """Advantages, normalised over all continuations, and the critic's targets."""
        assert values is not None
        rewards = tokens + whole[:, None] / tokens.shape[1]
        advantages, returns = generalised_advantages(
            rewards, values, discount=self.config.discount, decay=self.config.gae
        )
        return (advantages - advantages.mean()) / (advantages.std() + 1e-8), returns

    def loss(self, batch: RolloutBatch, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        assert batch.old is not None
        assert batch.values is not None
        assert batch.returns is not None
        scores = self.policy.score(batch.prompts, batch.codes, batch.support)
        kl = self.divergence(scores, batch.prompts, batch.codes)
        found = ppo_loss(
            policy=scores.log_probs,
            old=batch.old,
            advantages=self.credited(batch.advantages),
            values=self.critic(scores.hidden),
            old_values=batch.values,
            returns=batch.returns,
            clip=self.config.ratio_clip,
        )
        total = found.policy + found.value + self.config.kl_weight * kl.mean()
        return Loss(total, self.logged(self.logged_means(batch) | found._asdict(), kl, scores))
