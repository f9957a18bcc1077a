"""Compare two bundles with the learned rewards as judges, sound by sound, and write what they say as a study's answers.

    python scripts/judge_bundles.py OLD NEW --recordings RECORDINGS --quality runs/quality --alignment runs/alignment \
        -o judgements.csv

Both bundles perform the same sounds of RECORDINGS' dev split (read as by `echoavatar evaluate BUNDLE alive`), with the
same seeds. Each reward (`echoavatar align reward-quality`, `reward-alignment`) prefers the performance whose windows of
4 s have the higher mean. No reward knows which bundle made a motion: codes for the alignment reward are made from the
finished motion of both, with the tokenizer of `--model`. The table has the columns of the studio's `judgements.csv`;
`overall_preference` is 2 for the first system, -2 for the second. The last line is JSON with shares and 95 % intervals.
"""

import argparse
import csv
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import binomtest
from torch import Tensor

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.models.audio import AudioCodec
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import Motion, to_features
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, FRAMES_PER_MOTION_TOKEN, MOTION_TOKENS_PER_CHUNK
from echoavatar_lab.align.audio_reward import WINDOW_TOKENS, AudioMotion
from echoavatar_lab.align.quality import QualityReward
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.evaluation.takes import Sound, read_sounds
from echoavatar_lab.models.tokenize import audio_codes

AUDIO_PER_TOKEN = AUDIO_FRAMES_PER_CHUNK // MOTION_TOKENS_PER_CHUNK
WINDOW_FRAMES = WINDOW_TOKENS * FRAMES_PER_MOTION_TOKEN
HEAD = ("rater", "role", "sound", "category", "first_system", "second_system", "overall_preference")


def features_of(tokenizer: BodyTokenizer, motion: Motion) -> Float[Tensor, "t c"]:
    """What rewards and tokenizer read."""
    return torch.from_numpy(to_features(tokenizer.skeleton, motion.matrices(), motion.root))


@torch.inference_mode()
def quality_of(reward: QualityReward, tokenizer: BodyTokenizer, motion: Motion) -> float:
    """Mean score of the windows of 4 s."""
    windows = features_of(tokenizer, motion).unfold(0, WINDOW_FRAMES, WINDOW_FRAMES // 2).transpose(1, 2)
    return float(reward(windows).mean())


@torch.inference_mode()
def alignment_of(
    reward: AudioMotion, codec: AudioCodec, tokenizer: BodyTokenizer, sound: Sound, motion: Motion
) -> float:
    """Mean cosine of sound and motion over the windows of 4 s."""
    features = features_of(tokenizer, motion)
    usable = len(features) // FRAMES_PER_MOTION_TOKEN * FRAMES_PER_MOTION_TOKEN
    seen = tokenizer.encode(features[None, :usable])[0]
    heard = torch.from_numpy(audio_codes(codec, sound.audio).astype(np.int64))
    tokens = min(len(seen), len(heard) // AUDIO_PER_TOKEN)
    starts = range(0, tokens - WINDOW_TOKENS + 1, WINDOW_TOKENS // 2)
    motion_windows = torch.stack([seen[at : at + WINDOW_TOKENS] for at in starts])
    audio_windows = torch.stack([heard[at * AUDIO_PER_TOKEN : (at + WINDOW_TOKENS) * AUDIO_PER_TOKEN] for at in starts])
    return float((reward.embed_audio(audio_windows) * reward.embed_motion(motion_windows)).sum(1).mean())


def performances(bundle: str, sounds: Sequence[Sound], seed: int) -> list[Motion]:
    """The bundle's motion to each sound."""
    seeds = range(seed, seed + len(sounds))
    pipeline = Pipeline(load_bundle(bundle))
    return [made.motion for made in animate_many(pipeline, [sound.audio for sound in sounds], seeds=seeds)]


def share(wins: int, count: int) -> dict[str, float]:
    """Share of the first system with Wilson's 95 % interval."""
    interval = binomtest(wins, count).proportion_ci(method="wilson")
    return {"share": wins / count, "low": interval.low, "high": interval.high, "sounds": count}


def main() -> None:
    """See the top of this file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", help="bundle")
    parser.add_argument("new", help="bundle")
    parser.add_argument("--recordings", type=Path, required=True)
    parser.add_argument("--quality", type=Path, required=True, help="trained quality reward")
    parser.add_argument("--alignment", type=Path, required=True, help="trained alignment reward")
    parser.add_argument("--model", default="default", help="bundle whose codes the rewards read (default: default)")
    parser.add_argument("--count", type=int, default=12, help="voices, and tracks (default: 12)")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, required=True, help="table of all judgements (.csv)")
    args = parser.parse_args()
    reader = load_bundle(args.model)
    quality, alignment = QualityReward.load(args.quality), AudioMotion.load(args.alignment)
    sounds = read_sounds(args.recordings, args.seconds, args.count)
    made = {name: performances(bundle, sounds, args.seed) for name, bundle in (("new", args.new), ("old", args.old))}
    rows, wins = [], dict[tuple[str, str], list[bool]]()
    for number, sound in enumerate(sounds):
        scores = {
            "quality": [quality_of(quality, reader.tokenizer, made[name][number]) for name in ("new", "old")],
            "alignment": [
                alignment_of(alignment, reader.codec, reader.tokenizer, sound, made[name][number])
                for name in ("new", "old")
            ],
        }
        for judge, (new, old) in scores.items():
            rows.append((judge, "reward", sound.name, sound.kind, "new", "old", 2 if new > old else -2))
            for category in (sound.kind, "all"):
                wins.setdefault((judge, category), []).append(new > old)
            print(f"{judge:<10} {sound.kind:<7} {sound.name:<36} new {new:.3f}  old {old:.3f}")
    with args.output.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEAD)
        writer.writerows(rows)
    found = {f"{judge}, {category}": share(sum(won), len(won)) for (judge, category), won in wins.items()}
    print(json.dumps({name: {key: round(value, 3) for key, value in row.items()} for name, row in found.items()}))


if __name__ == "__main__":
    main()
