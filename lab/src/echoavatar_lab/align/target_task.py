"""The training task of `align targets`: GRPO with a `TargetJudge`, on prompts of both kinds of sound alike."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import MotionError
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, CHUNK_FRAMES, FRAME_RATE_HZ, MOTION_TOKENS_PER_CHUNK
from echoavatar_lab.evaluation.metrics.liveliness import MUSIC, SPEECH, body_points
from echoavatar_lab.evaluation.takes import Take
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.training import Loss

from .batch_motion import liveliness
from .prompts import Prompt, PromptSampler, batch_of, read_token_clips, train_and_test
from .rollouts import GrpoTask, RolloutBatch
from .start import load_policy
from .targets import TargetJudge, Targets, kind_of, kinds_of, means_of, measured, targets_like
from .trainer import AlignTraining, RunContext, rollout_seeds

SHARES = {MUSIC: 0.5, SPEECH: 0.375}  # of the prompts of a batch; the others are of any sound
HOP = 0.2  # of a window: from one captured window to the next
BEFORE_TUNING = 10**6  # number of the first draw that no step uses
TRUTH_DRAWS, TOGETHER = 10, 64  # draws of true speech, and prompts of each
KEPT = 22  # chunks of the past that a continuation is scored behind; the shipped generator sees 15
ROUNDS = 4  # draws that the other generator is measured with


class PromptsByKind(PromptSampler):
    """Half of a draw is filled with music and three eighths with speech, so that both opponents learn at once."""

    def draw(self, number: int, size: int) -> list[Prompt]:
        """`size` prompts of draw `number`: music first, then speech, then any sound."""
        counts = {kind: round(share * size) for kind, share in SHARES.items()}
        found, turn = [], 0
        for kind, count in (counts | {"": size - sum(counts.values())}).items():
            kept: list[Prompt] = []
            while len(kept) < count:
                if turn > 1000:
                    raise MotionError(f"hardly a prompt is filled with {kind}: use token files of both kinds of sound")
                drawn = super().draw(number * 1009 + turn, size)
                kept += [prompt for prompt in drawn if not kind or kind_of(prompt) == kind]
                turn += 1
            found += kept[:count]
        return found


class TargetTask(GrpoTask):
    """GRPO with a judge that learns during the run; the judge's state is saved with the run's."""

    judge: TargetJudge

    def _with_own_past(self, drawn: Sequence[Prompt], number: int) -> list[Prompt]:
        """The prompts with a long past that the policy made, as in a session, cut to the end of that past."""
        made = super()._with_own_past(drawn, number)
        cut = max(0, self.config.past - KEPT)
        return [
            replace(
                one,
                audio=one.audio[cut * AUDIO_FRAMES_PER_CHUNK :],
                past=one.past[cut * MOTION_TOKENS_PER_CHUNK :],
                start=one.start + cut,
            )
            for one in made
        ]

    def loss(self, batch: RolloutBatch, step: int) -> Loss:
        """See `TrainingTask.loss`; also logs the batch's means and the weights."""
        found = super().loss(batch, step)
        return Loss(found.total, dict(found.metrics) | self.judge.told)

    def state(self) -> Mapping[str, Tensor]:
        """The opponents' windows and classifiers, and the targets' weights and means."""
        own = {
            f"opponent.{kind}.{name}": torch.from_numpy(value)
            for kind, one in self.judge.opponents.items()
            for name, value in one.state().items()
        }
        weights = self.judge.weights
        own |= {f"weight.{name}": torch.tensor(value, dtype=torch.float64) for name, value in weights.values.items()}
        own |= {f"mean.{name}": torch.tensor(value, dtype=torch.float64) for name, value in weights.means.items()}
        return own

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """See `TrainingTask.load_state`."""
        for kind, opponent in self.judge.opponents.items():
            start = f"opponent.{kind}."
            opponent.load_state({n.removeprefix(start): v.numpy() for n, v in state.items() if n.startswith(start)})
        for what, values in (("weight.", self.judge.weights.values), ("mean.", self.judge.weights.means)):
            values |= {name.removeprefix(what): float(v) for name, v in state.items() if name.startswith(what)}


def target_task(
    training: AlignTraining,
    tokens: Path,
    folder: Path,
    captured: Sequence[Take],
    *,
    bundle: str | Path = "default",
    generator: Path | None = None,
    like: Path | None = None,
    sampling: Mapping[str, float] | None = None,
    device: str = "cpu",
) -> TargetTask:
    """The training task; its targets are shares of the means of `like` or else of the bundle's generator.

    They are kept in `folder` as `targets.json`, and a resumed run keeps those that it began with.

    Raises:
        CheckpointError: a checkpoint is missing or damaged.
        MotionError: token files or captured clips are missing or do not fit.
    """
    parts, policy, reference, card = load_policy(tokens, bundle, generator, sampling or {})
    tokenizer = parts.tokenizer.to(device)
    train, _ = train_and_test(read_token_clips(tokens, policy.config.layout, needs_truth=True), tokens)
    book = PromptsByKind(
        train, past=training.past, length=training.length, seed=training.seed, fewest_events=training.fewest_events
    )
    people = {MUSIC: people_in_music(captured, training.length), SPEECH: people_in_speech(tokenizer, book, device)}
    kept = folder / "targets.json"
    if kept.exists():
        targets = Targets.load(kept)
    else:
        other = Generator.load(like) if like else load_bundle(bundle).generator
        targets = Targets(targets=targets_like(means_like(other.to(device), tokenizer, book, training)))
        targets.save(kept)
    context = RunContext(card=card, reference_name=str(generator or bundle))
    return TargetTask(policy, reference, training, TargetJudge(tokenizer, people, targets.targets), context, book=book)


def people_in_music(captured: Sequence[Take], length: int) -> Float[np.ndarray, "n 9"]:
    """Statistics of captured dancers in windows of `length` chunks.

    Raises MotionError if a clip is not of 30 frames a second, or there is none of dance.
    """
    frames, rows = length * CHUNK_FRAMES, []
    for take in captured:
        if take.kind != MUSIC:
            continue
        if abs(take.motion.fps - FRAME_RATE_HZ) > 0.1:
            raise MotionError(f"{take.name} has {take.motion.fps:g} frames a second; bring it to {FRAME_RATE_HZ}")
        points = torch.from_numpy(body_points(take.motion)).float()
        starts = range(0, len(points) - frames + 1, round(HOP * frames))
        if starts:
            rows.append(liveliness(torch.stack([points[at : at + frames] for at in starts])).numpy())
    if not rows:
        raise MotionError("the captured clips hold no dance that lasts as long as a continuation")
    return _finite(np.concatenate(rows))


def people_in_speech(tokenizer: BodyTokenizer, book: PromptsByKind, device: str) -> Float[np.ndarray, "n 9"]:
    """Statistics of the clips' own continuations in speech."""
    rows: list[Float[np.ndarray, "n 9"]] = []
    for number in range(TRUTH_DRAWS):
        drawn = [prompt for prompt in book.draw(BEFORE_TUNING + number, TOGETHER) if kind_of(prompt) == SPEECH]
        truth = torch.from_numpy(np.stack([prompt.truth for prompt in drawn]).astype(np.int64)).to(device)
        rows.append(_finite(measured(tokenizer, drawn, truth).statistics))
    return np.concatenate(rows)


def means_like(
    generator: Generator, tokenizer: BodyTokenizer, book: PromptsByKind, training: AlignTraining
) -> dict[str, float]:
    """Means of a generator's own continuations (`targets.means_of`), behind as much of its own past as in the run."""
    task, found = TargetTask(generator, generator, training, TargetJudge(tokenizer, {}, {}), book=book), []
    for number in range(BEFORE_TUNING, BEFORE_TUNING + ROUNDS):
        drawn = task._with_own_past(book.draw(number, training.batch), number)
        seeds = rollout_seeds(training, number, len(drawn)).to(task.device)
        codes = task.policy.rollout(batch_of(drawn, str(task.device)), 1, seeds)
        found.append(means_of(measured(tokenizer, drawn, codes), kinds_of(drawn)))
    return {name: float(np.mean([one[name] for one in found])) for name in found[0]}


def _finite(rows: Float[np.ndarray, "n 9"]) -> Float[np.ndarray, "m 9"]:
    return np.asarray(rows[np.isfinite(rows).all(1)])
