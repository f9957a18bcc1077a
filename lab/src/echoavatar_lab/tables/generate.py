"""Motion from sound: through the live pipeline with all its stages, or as decoded codes alone."""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.models.audio import AudioCodec
from echoavatar.models.generator import Generator
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import Motion, from_features
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.timing import CHUNK_SAMPLES, FRAME_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar_lab.training import Progress

Sounds = Mapping[int, Float[np.ndarray, " s"]]
"""Sounds (24 kHz), by the seed of the sampling noise."""


def live_motion(
    name: str,
    codec: AudioCodec,
    tokenizer: BodyTokenizer,
    generator: Generator,
    sounds: Sounds,
    *,
    runtime: str = "paper",
    device: str = "cpu",
    progress: Progress | None = None,
) -> list[Motion]:
    """Run one engine session per sound, all in one batch, as `runtime` says (`Runtime.chosen`).

    A generator with lookahead is given the whole sounds beforehand.
    """
    from echoavatar.engine import animate_many
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar.engine.pipeline.bundle import Bundle
    from echoavatar.engine.pipeline.runtime import Runtime
    from echoavatar_lab.tables.lookahead import LookaheadPipeline

    own = Runtime(level_control=generator.config.is_leveled)
    bundle = Bundle(name, codec, tokenizer, generator.eval(), {}, runtime=own).running(runtime)
    hears_ahead = generator.config.ahead_chunks > 0
    pipeline = LookaheadPipeline(bundle, sounds, device=device) if hears_ahead else Pipeline(bundle, device=device)
    done = animate_many(pipeline, list(sounds.values()), seeds=list(sounds), progress=progress)
    return [each.motion for each in done]


@torch.inference_mode()
def decoded_motion(
    codec: AudioCodec,
    tokenizer: BodyTokenizer,
    generator: Generator,
    sounds: Sounds,
    *,
    device: str = "cpu",
    progress: Progress | None = None,
) -> list[Motion]:
    """Sample codes for all sounds in one batch and decode them on the tokenizer's rig.

    Nothing behind the decoder runs: published tables do so.
    """
    from echoavatar.models.generator import open_stream
    from echoavatar_lab.models.tokenize import audio_codes

    stream, count = open_stream(generator.eval().to(device)), len(sounds)
    longest = max(len(sound) for sound in sounds.values())
    samples = longest + -longest % CHUNK_SAMPLES
    is_leveled = generator.config.is_leveled
    padded = [np.pad(sound, (0, samples - len(sound))) for sound in sounds.values()]
    codes = [audio_codes(codec, sound, is_leveled=is_leveled) for sound in padded]
    heard, seeds = torch.from_numpy(np.stack(codes)).long(), torch.tensor(list(sounds))
    active = torch.ones(count, dtype=torch.bool, device=device)
    made = stream.step(heard.to(device), stream.init_state(count), active, seeds=seeds.to(device))  # type: ignore[arg-type]
    motions = []
    for number, (sound, drawn) in enumerate(zip(sounds.values(), made.cpu(), strict=True), 1):
        frames = len(sound) // SAMPLES_PER_FRAME
        body = from_features(tokenizer.skeleton, tokenizer.decode(drawn[None])[0])
        turns, root = quaternion_from_matrix(body.rotations[:frames]).numpy(), body.root[:frames].numpy()
        motions.append(Motion(tokenizer.skeleton, turns, root, float(FRAME_RATE_HZ)))
        if progress:
            progress(number, count)
    return motions
