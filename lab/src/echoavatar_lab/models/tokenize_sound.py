"""Tokenize sound that has no recorded motion, as prompts of reinforcement learning.

A prompt needs past motion. Here the generator that is to be tuned makes it, as in a live session. Such token files have
`has_truth` false: they are not used for reference statistics, reward models or generators.
"""

from collections.abc import Callable
from pathlib import Path
from zlib import crc32

import numpy as np
import torch
from jaxtyping import Int

from echoavatar.models.audio import AudioCodec
from echoavatar.models.generator import Generator, open_stream
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.data import Sound, SoundSet
from echoavatar_lab.models.generator.windows import TokenClip

from .tokenize import audio_codes, cues_at


def tokenize_sounds(
    sounds: SoundSet,
    codec: AudioCodec,
    generator: Generator,
    folder: Path,
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Write a token file for each sound and return the number of sounds; existing files are kept.

    Raises:
        AudioError: a sound's file is missing or damaged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for done, sound in enumerate(sounds.sounds, start=1):
        path = folder / f"{sound.name}.npz"
        if not path.exists():
            _clip(sounds, sound, codec, generator, seed).save(path)
        if progress:
            progress(done, len(sounds.sounds))
    return len(sounds.sounds)


def _clip(sounds: SoundSet, sound: Sound, codec: AudioCodec, generator: Generator, seed: int) -> TokenClip:
    audio = audio_codes(codec, sounds.load(sound), is_leveled=generator.config.is_leveled)
    events = {kind: np.array(times) for kind, times in sound.events.items()}
    return TokenClip(
        audio,
        own_motion(generator, audio, seed=seed ^ crc32(sound.name.encode())),
        sound.domain[::FRAMES_PER_MOTION_TOKEN],
        sound.split,
        cues_at(events, len(audio)),
        generator.config.patience,
        has_truth=False,
        is_leveled=generator.config.is_leveled,
    )


@torch.inference_mode()
def own_motion(generator: Generator, audio: Int[np.ndarray, "f l"], *, seed: int) -> Int[np.ndarray, "n p q"]:
    """The motion codes that a generator makes for a whole recording, from a fresh state, at its own temperature."""
    stream = open_stream(generator)
    usable = len(audio) // generator.config.audio_frames * generator.config.audio_frames
    heard = torch.from_numpy(audio[None, :usable].astype(np.int64))
    one, seeds = torch.ones(1, dtype=torch.bool), torch.tensor([seed])
    codes = stream.step(heard, stream.init_state(1), one, seeds=seeds)  # type: ignore[arg-type]
    return codes[0].numpy().astype(np.int16)
