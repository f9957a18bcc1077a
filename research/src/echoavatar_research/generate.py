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
from echoavatar.training import Progress

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
    progress: Progress | None = None,
) -> list[Motion]:
    """Run one engine session per sound, as `runtime` says (`Runtime.chosen`).

    A generator with lookahead is given the whole sounds beforehand.
    """
    from echoavatar.engine import animate_many
    from echoavatar.engine.pipeline import Pipeline
    from echoavatar.engine.pipeline.bundle import Bundle
    from echoavatar_research.lookahead import LookaheadPipeline

    bundle = Bundle(name, codec, tokenizer, generator.eval(), {}).running(runtime)
    hears_ahead = generator.config.ahead_chunks > 0
    pipeline = LookaheadPipeline(bundle, sounds) if hears_ahead else Pipeline(bundle)
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
    """Sample and decode codes on the tokenizer's rig, without the stages behind the decoder: published tables do so."""
    from echoavatar.engine.pipeline.tokenize import audio_codes
    from echoavatar.models.generator import open_stream

    stream, motions = open_stream(generator.eval().to(device)), []
    one = torch.ones(1, dtype=torch.bool, device=device)
    for number, (seed, sound) in enumerate(sounds.items(), 1):
        frames = len(sound) // SAMPLES_PER_FRAME
        heard = torch.from_numpy(audio_codes(codec, np.pad(sound, (0, -len(sound) % CHUNK_SAMPLES)))).long()
        heard, seeds = heard[None].to(device), torch.tensor([seed], device=device)
        codes = stream.step(heard, stream.init_state(1), one, seeds=seeds)  # type: ignore[arg-type]
        made = from_features(tokenizer.skeleton, tokenizer.decode(codes.cpu())[0])
        turns, root = quaternion_from_matrix(made.rotations[:frames]).numpy(), made.root[:frames].numpy()
        motions.append(Motion(tokenizer.skeleton, turns, root, float(FRAME_RATE_HZ)))
        if progress:
            progress(number, len(sounds))
    return motions
