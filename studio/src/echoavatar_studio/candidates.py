"""Candidates of a preference study: N continuations of a prompt, as codes and as motion (paper, DPO).

The prompt is a stretch of sound with a past: the motion that the generator itself made for the sound before. The policy
that `align dpo` tunes samples the codes. The live pipeline turns them into motion, with a generator that returns given
codes.
"""

from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from echoavatar.engine.manner import TALKER
from echoavatar.engine.pipeline import Bundle, Pipeline
from echoavatar.engine.settling import Settling
from echoavatar.errors import AudioError
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.motion.stages.stillness import WHOLE
from echoavatar.timing import CHUNK_FRAMES, CHUNK_SAMPLES, FRAME_RATE_HZ, MOTION_TOKENS_PER_CHUNK
from echoavatar_lab.align.policy import GeneratorPolicy
from echoavatar_lab.align.prompts import PromptSampler, batch_of
from echoavatar_lab.data import DOMAINS
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenize import audio_codes, own_motion

from .clips import Performance
from .settings import PreferenceStudy
from .sources import SoundCut

Codes = list[list[list[int]]]


class Candidate(NamedTuple):
    """One continuation."""

    codes: Codes  # motion tokens x parts x layers
    shown: Performance
    seed: int


def token_file(folder: Path, bundle: Bundle, cut: SoundCut, seed: int) -> TokenClip:
    """Write the sound's codes, with the generator's own motion as past, to `folder` for `align dpo`.

    Raises:
        AudioError: the sound is shorter than a chunk.
    """
    if len(cut.audio) < CHUNK_SAMPLES:
        raise AudioError(f"{cut.name} is shorter than a chunk of {CHUNK_SAMPLES} samples; leave it out")
    audio = audio_codes(bundle.codec, cut.audio, is_leveled=bundle.runtime.level_control)
    motion = own_motion(bundle.generator, audio, seed=seed ^ crc32(cut.name.encode()))
    label = DOMAINS.index("music" if cut.category == "dance" else "speech")
    clip = TokenClip(
        audio, motion, np.full(len(motion), label, np.uint8), patience=bundle.generator.config.patience, has_truth=False
    )
    folder.mkdir(parents=True, exist_ok=True)
    clip.save(folder / f"{token_name(cut)}.npz")
    return clip


def token_name(cut: SoundCut) -> str:
    """A file-safe name for the token file of a sound."""
    return "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in cut.name)


def starts(clip: TokenClip, settings: PreferenceStudy, name: str) -> list[int]:
    """The chunks at which the prompts of a sound begin, evenly spread.

    Raises:
        AudioError: the sound is too short for a prompt.
    """
    last = clip.chunks - settings.past - settings.length
    if last < 0:
        raise AudioError(
            f"{name} has {clip.chunks} chunks, a prompt takes {settings.past} + {settings.length};"
            " use longer sounds, or lower `length`"
        )
    count = min(settings.prompts_per_sound, last + 1)
    return [int(at) for at in np.linspace(0, last, count).round()]


def candidates(
    pipeline: Pipeline, bundle: Bundle, cut: SoundCut, clip: TokenClip, start: int, settings: PreferenceStudy
) -> list[Candidate]:
    """`settings.candidates` continuations of the prompt at `start`, each with the seed that reproduces it."""
    name = token_name(cut)
    prompt = PromptSampler({name: clip}, past=settings.past, length=settings.length).cut(name, start)
    random = np.random.default_rng([settings.seed, crc32(name.encode()), start])
    seeds = [int(seed) for seed in random.integers(2**53, size=settings.candidates)]
    batch = batch_of([prompt])
    codes = GeneratorPolicy(bundle.generator).rollout(batch, len(seeds), torch.tensor(seeds))
    whole = torch.cat([batch.past.repeat_interleave(len(seeds), 0), codes], 1)
    first = start * CHUNK_SAMPLES
    sound = cut.audio[first : first + (settings.past + settings.length) * CHUNK_SAMPLES]
    shown = decode(pipeline, sound, whole)
    seen = settings.past * CHUNK_FRAMES
    return [
        Candidate(
            codes[row].tolist(),
            Performance(
                motion.motion.cut(seen, motion.motion.frames), None if motion.face is None else motion.face[seen:]
            ),
            seeds[row],
        )
        for row, motion in enumerate(shown)
    ]


@torch.inference_mode()
def decode(pipeline: Pipeline, sound: np.ndarray, codes: Int[Tensor, "b n p q"]) -> list[Performance]:
    """Turn codes into performances, one per row, through the live pipeline: decoder, face and all later stages.

    As in a session, a body talks unless its legs dance. The codes were drawn for no manner, so no hand is told to rest.
    """
    rows, chunks = len(codes), codes.shape[1] // MOTION_TOKENS_PER_CHUNK
    generator, everyone = pipeline.generator, np.ones(len(codes), np.bool_)
    state, settling = pipeline.init_state(rows), [Settling(pipeline.chunk) for _ in range(rows)]
    steps = list[list[MotionChunk]]()
    pipeline.reset(state, everyone, seed=0)
    pipeline.generator = ScriptedGenerator(codes.cpu().numpy())
    try:
        blocks = np.split(np.tile(sound[: chunks * CHUNK_SAMPLES], (rows, 1)), chunks, 1)
        for number, block in enumerate(blocks):
            hands = np.stack([WHOLE if own.is_dancing(number - 1) else TALKER for own in settling])
            steps.append(pipeline.step(block, state, everyone, hands=hands if pipeline.has_manner else None))
            for own, audio, made in zip(settling, block, steps[-1], strict=True):
                own.made(number, audio, made, pipeline.skeleton)
    finally:
        pipeline.generator = generator
    whole = [join(list(row)) for row in zip(*steps, strict=True)]
    return [
        Performance(Motion(pipeline.skeleton, row.rotations, row.root, float(FRAME_RATE_HZ)), row.face) for row in whole
    ]


class ScriptedGenerator:
    """Takes the place of a generator and returns codes that were sampled before, regardless of the sound."""

    def __init__(self, codes: Int[np.ndarray, "b n p q"]) -> None:
        self._parts = iter(np.split(codes, codes.shape[1] // MOTION_TOKENS_PER_CHUNK, 1))

    def step(self, *heard: object, **how: object) -> Int[np.ndarray, "b n p q"]:
        """The codes of the next chunk."""
        return next(self._parts)
