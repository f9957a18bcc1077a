"""From folders to a running trainer: bundle, tokens, yardstick, rewards."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..checkpoint import read_card
from ..errors import MotionError
from ..generator import Generator, TokenClip
from ..pipeline import load_bundle
from ..tokenizer import BodyTokenizer
from .audio_reward import AudioMotion
from .config import AlignTraining, Method
from .dpo import DpoTrainer
from .grpo import GrpoTrainer
from .judge import SceneJudge
from .policy import GeneratorPolicy
from .ppo import PpoTrainer
from .preferences import rank, read_pairs, write_pairs
from .prompts import PromptBook, read_token_clips
from .quality import QualityReward
from .rewards import Reward, RewardMix, parse_weights
from .scene import true_scenes
from .trainer import AlignTrainer, run
from .yardstick import Yardstick, measure_yardstick

DEFAULT_REWARDS = (
    "beats=1",
    "stresses=1",
    "liveliness=0.3",
    "smoothness=0.1",
    "planted_feet=0.1",
    "stillness=0.5",
)
YARDSTICK_PROMPTS = 160
YARDSTICK_PAST, YARDSTICK_LENGTH = 3, 9
TOGETHER = 8  # prompts whose continuations are drawn at once


@dataclass(frozen=True)
class Setting:
    """What all methods need."""

    tokenizer: BodyTokenizer
    generator: Generator
    reference: Generator
    reference_name: str
    train: dict[str, TokenClip]
    test: dict[str, TokenClip]
    mix: RewardMix
    card: dict[str, object]


def setting(
    tokens: Path,
    folder: Path,
    *,
    bundle: str | Path = "default",
    generator: Path | None = None,
    reference: Path | None = None,
    rewards: Sequence[str] | None = None,
    yardstick: Path | None = None,
    sampling: Mapping[str, float | None] | None = None,
    quality: Path | None = None,
    alignment: Path | None = None,
    is_compared: bool = False,
) -> Setting:
    """Load everything; a yardstick that is not given is measured on the train clips and kept in `folder`.

    With `is_compared` (DPO) rewards only tell of progress on held-out clips: where there is neither true motion nor a
    yardstick, as in the token files of a studio, none is measured.

    Raises:
        CheckpointError: a checkpoint is missing or damaged.
        MotionError: the token files are missing or of another vocabulary.
        EchoAvatarError: an unknown reward.
    """
    parts = load_bundle(bundle)
    policy = Generator.load(generator) if generator else parts.generator
    given = {name: value for name, value in (sampling or {}).items() if value is not None}
    policy.config = policy.config.model_copy(update=given)
    kept_near = Generator(policy.config)
    kept_near.load_state_dict(policy.state_dict())
    if reference:
        kept_near = Generator.load(reference)
    clips = read_token_clips(tokens, policy.config.layout)
    train = {name: clip for name, clip in clips.items() if clip.split == "train"}
    test = {name: clip for name, clip in clips.items() if clip.split != "train"}
    if not train:
        raise MotionError(f"{tokens} holds no clip of split train; there is nothing to draw prompts from")
    has_yardstick = yardstick is not None or (folder / "yardstick.json").exists()
    is_unmeasured = (
        is_compared and not rewards and not has_yardstick and not any(c.has_truth for c in train.values())
    )
    weights = {} if is_unmeasured else parse_weights(rewards or DEFAULT_REWARDS)
    own: dict[str, Reward] = {}
    if quality:
        own["quality"] = QualityReward.load(quality).judge
    if alignment:
        own["alignment"] = AudioMotion.load(alignment).judge
    rule = None if is_unmeasured else measured(parts.tokenizer, train, yardstick, folder)
    mix = RewardMix(weights, rule, own)
    begun = read_card(generator) if generator else parts.card
    card = {
        "data": str(tokens),
        "licence": begun.get("licence", "Apache-2.0"),
        "begun_from": str(generator or bundle),
        "rewards": weights,
    }
    name = str(reference or generator or bundle)
    return Setting(parts.tokenizer, policy, kept_near, name, train, test, mix, card)


def measured(
    tokenizer: BodyTokenizer, clips: Mapping[str, TokenClip], given: Path | None, folder: Path
) -> Yardstick:
    """The yardstick of `given`, or of `folder`, or measured on evenly chosen true motion and kept there."""
    own = folder / "yardstick.json"
    if given or own.exists():
        return Yardstick.load(given or own)
    clips = {name: clip for name, clip in clips.items() if clip.has_truth}
    if not clips:
        raise MotionError(
            "rewards are measured against true motion, and these token files hold sound with a generator's own motion"
            " only; pass the --yardstick that a run on a folder of `echoavatar train tokens` has left"
        )
    book = PromptBook(clips, past=YARDSTICK_PAST, length=YARDSTICK_LENGTH)
    prompts = book.spread(YARDSTICK_PROMPTS)
    found = measure_yardstick(
        [
            scene
            for at in range(0, len(prompts), 24)
            for scene in true_scenes(tokenizer, prompts[at : at + 24])
        ]
    )
    folder.mkdir(parents=True, exist_ok=True)
    found.save(own)
    return found


def train(
    method: Method,
    training: AlignTraining,
    ready: Setting,
    folder: Path,
    *,
    device: str = "cpu",
    pairs: Path | None = None,
    margin: float = 0.0,
    minutes: float | None = None,
    command: str = "",
    progress: Callable[[int, int], None] | None = None,
) -> Generator:
    """Tune by one of the methods."""

    def book(clips: Mapping[str, TokenClip]) -> PromptBook:
        return PromptBook(
            clips,
            past=training.past,
            length=training.length,
            seed=training.seed,
            fewest_events=training.fewest_events,
            events=training.events,
        )

    judge = SceneJudge(ready.tokenizer, ready.mix)
    parts = (ready.generator, ready.reference, training, judge)
    where = {"device": device, "reference_name": ready.reference_name}
    trainer: AlignTrainer
    match method:
        case "grpo":
            trainer = GrpoTrainer(*parts, book=book(ready.train), **where)
        case "ppo":
            trainer = PpoTrainer(*parts, book=book(ready.train), **where)
        case "dpo":
            if pairs is None:
                raise MotionError(
                    "dpo needs preference pairs: pass --pairs, made by `echoavatar align rollouts`"
                )
            everything = PromptBook(ready.train | ready.test, past=training.past, length=training.length)
            compared = read_pairs(pairs, everything, ready.generator.config.layout, margin=margin)
            trainer = DpoTrainer(*parts, pairs=compared, **where)
    held_out = book(ready.test) if ready.test and ready.mix.weights else None
    card = ready.card | {"command": command}
    return run(trainer, folder, held_out=held_out, card=card, minutes=minutes, progress=progress)


def make_pairs(
    ready: Setting,
    path: Path,
    *,
    prompts: int,
    past: int,
    length: int,
    group: int,
    margin: float,
    fewest_events: int,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Continuations of prompts of the train clips, best against worst by reward, as a file of pairs."""
    book = PromptBook(ready.train, past=past, length=length, seed=seed, fewest_events=fewest_events)
    policy, judge = GeneratorPolicy(ready.generator), SceneJudge(ready.tokenizer, ready.mix)
    pairs = []
    for first in range(0, prompts, TOGETHER):
        some = min(TOGETHER, prompts - first)
        drawn = book.draw(first // TOGETHER, TOGETHER)[:some]
        pairs += rank(
            policy, drawn, judge, past=past, group=group, margin=margin, seed=seed * 1_000_003 + first
        )
        if progress is not None:
            progress(first + some, prompts)
    return write_pairs(path, pairs)
