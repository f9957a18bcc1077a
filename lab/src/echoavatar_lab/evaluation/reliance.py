"""Does the generator use the audio? NLL per code with the true audio and other audio (paper, conditional collapse).

A model that has collapsed onto its own history loses nothing with another clip's audio. The gain is what the audio is
worth to the model in nats per code, much of it for telling speech from music. What a clip's own audio is worth over the
same audio a few chunks late is the value of timing (`timing_gain`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from echoavatar.engine.pipeline import Bundle
from echoavatar.models.generator import Generator
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.data import Clip
from echoavatar_lab.models.generator.reliance import nll_by_domain
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenize import audio_codes, motion_codes

HEARD = ("silence", "speech", "music", "all")
LATE_CHUNKS = 3  # 0.8 s: other syllables and beats, but the same voice and piece


def token_clips(bundle: Bundle, clips: Sequence[Clip]) -> list[TokenClip]:
    """The clips as codes of the bundle's codec and tokenizer, with the patience of the generator's training data."""
    patience = bundle.generator.config.patience
    return [
        TokenClip(
            audio_codes(bundle.codec, clip.audio, is_leveled=bundle.runtime.level_control),
            motion_codes(bundle.tokenizer, clip, patience=patience),
            clip.domain[::FRAMES_PER_MOTION_TOKEN],
            clip.split,
        )
        for clip in clips
    ]


def reliance(generator: Generator, tokens: Sequence[TokenClip]) -> dict[str, float]:
    """`nll_X`, `nll_shuffled_X`, `nll_gain_X` and `timing_gain_X` for each X of `HEARD` that occurs."""
    true = nll_by_domain(generator, tokens)
    shuffled = nll_by_domain(generator, tokens, shuffled_audio=True)
    late = nll_by_domain(
        generator,
        [replace(clip, audio=np.roll(clip.audio, LATE_CHUNKS * AUDIO_FRAMES_PER_CHUNK, axis=0)) for clip in tokens],
    )
    scores: dict[str, float] = {}
    for name in HEARD:
        if name in true:
            scores |= {f"nll_{name}": true[name], f"nll_shuffled_{name}": shuffled[name]}
            scores[f"nll_gain_{name}"] = shuffled[name] - true[name]
            scores[f"timing_gain_{name}"] = late[name] - true[name]
    return scores


def reliance_table(generators: Mapping[str, Generator], tokens: Sequence[TokenClip]) -> str:
    """A Markdown table of generators side by side, by domain."""
    scores = {name: reliance(generator, tokens) for name, generator in generators.items()}
    lines = ["| heard | " + " | ".join(f"{name}: true | shuffled | gain | timing" for name in scores) + " |"]
    lines.append("|---|" + "---:|---:|---:|---:|" * len(scores))
    for heard in HEARD:
        if all(f"nll_{heard}" in row for row in scores.values()):
            cells = [
                f"{row[f'nll_{heard}']:.3f} | {row[f'nll_shuffled_{heard}']:.3f}"
                f" | {row[f'nll_gain_{heard}']:+.3f} | {row[f'timing_gain_{heard}']:+.3f}"
                for row in scores.values()
            ]
            lines.append(f"| {heard} | " + " | ".join(cells) + " |")
    return "\n".join(lines)
