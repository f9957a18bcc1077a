"""Motion for the sounds of a table: through the live pipeline, as decoded codes alone, or from another system's files.

The offline reference is a generator that hears ahead: it was trained on sound that is `ahead_chunks` ahead of its
motion (`TokenClip.heard_ahead`). A stream cannot provide that. Here the sounds are known from the start, and the
generator alone gets them early. Level control, silence, settling and everything behind the decoder use the sound that
is due, as live. Not in the paper.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from echoavatar.engine.pipeline.bundle import Bundle
from echoavatar.engine.pipeline.pipeline import Pipeline, PipelineState
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, CHUNK_SAMPLES, SAMPLES_PER_FRAME
from echoavatar_lab.data import Clip
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.evaluation.motion_folder import motion_files, read_motion_file
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.models.tokenize import audio_codes, motion_of_codes
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.progress import Progress, watched

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
    own = Runtime(level_control=generator.config.is_leveled)
    parts = {"codec": codec, "tokenizer": tokenizer, "generator": generator.eval()}
    bundle = Bundle.of(name, own, **parts).running(runtime)
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
    for sound, drawn in watched(list(zip(sounds.values(), made.cpu(), strict=True)), progress):
        frames = len(sound) // SAMPLES_PER_FRAME
        motions.append(motion_of_codes(tokenizer, drawn).cut(0, frames))
    return motions


@dataclass
class LookaheadState(PipelineState):
    """A `PipelineState` and the number of chunks that each row has had."""

    chunks: Int[np.ndarray, " b"]


class LookaheadPipeline(Pipeline):
    """A pipeline of sessions whose whole sound is known. With `ahead_chunks` 0 it equals `Pipeline`."""

    def __init__(self, bundle: Bundle, sounds: Mapping[int, Float[np.ndarray, " s"]], *, device: str = "cpu") -> None:
        """`sounds` (24 kHz) are keyed by the seed of the session that will hear them; silence follows each."""
        super().__init__(bundle, device=device)
        self._ahead, self._whole = bundle.sizes.ahead_chunks, bundle.codec
        self._codes = {0: self._codes_of(np.zeros(CHUNK_SAMPLES, np.float32))}  # for the warm start
        self._warm_row()
        self._codes = {seed: self._codes_of(sound) for seed, sound in sounds.items()}

    def _codes_of(self, sound: Float[np.ndarray, " s"]) -> Int[np.ndarray, "f l"]:
        """The codes that the generator gets, from the lead-in silence before the sound on."""
        padding = self._lead_in * CHUNK_SAMPLES, self._ahead * CHUNK_SAMPLES + -len(sound) % CHUNK_SAMPLES
        codes = audio_codes(self._whole, np.pad(sound, padding), is_leveled=self.level is not None).astype(np.int64)
        return codes[self._ahead * AUDIO_FRAMES_PER_CHUNK :]

    def init_state(self, rows: int) -> LookaheadState:
        """Sessions that have heard nothing."""
        return LookaheadState(**vars(super().init_state(rows)), chunks=np.zeros(rows, np.int64))

    def encode_audio(
        self, level: Float[np.ndarray, "b s"], state: PipelineState, active: Bool[np.ndarray, " b"]
    ) -> Int[np.ndarray, "b f l"]:
        """Codes of each row's sound `ahead_chunks` later; the sound that is pushed is not used."""
        assert isinstance(state, LookaheadState)
        codes = np.zeros((len(level), AUDIO_FRAMES_PER_CHUNK, self._whole.codebooks.shape[0]), np.int64)
        for row in np.flatnonzero(active):
            first = int(state.chunks[row]) * AUDIO_FRAMES_PER_CHUNK
            codes[row] = self._codes[int(state.seeds[row])][first : first + AUDIO_FRAMES_PER_CHUNK]
            state.chunks[row] += 1
        return codes


MISSING_FRAMES = 64  # EMAGE and its kin drop what does not fill their last window, up to two seconds


def foreign_motion(folder: Path, clip: Clip, skeleton: Skeleton, *, is_resampling: bool = False) -> Motion:
    """The motion of one test clip on the rig of the table, as long as the clip or up to 64 frames shorter.

    Raises MotionError if it is missing, too short, at another rate, not finite, or of a rig that does not fit;
    names the file.
    """
    files = motion_files(folder)
    if clip.name not in files:
        raise MotionError(
            f"{folder} lacks the test clip {clip.name} (it holds {len(files)} files, for example {next(iter(files))});"
            " name the files after the clips, and let the system make all of them"
        )
    path = files[clip.name]
    motion = read_motion_file(path, is_resampling=is_resampling, skeleton=skeleton).motion
    if motion.frames < clip.frames - MISSING_FRAMES:
        raise MotionError(
            f"{path} has {motion.frames} frames, the test clip {clip.frames}; make motion for the whole sound"
        )
    return motion.cut(0, min(motion.frames, clip.frames))
