"""Prompts for reinforcement learning: audio and the motion before it, cut from token clips at chunk borders.

A prompt is a moment of a session: the audio and motion of the past `past` chunks, and the audio of the next `length`
chunks. Beats and stressed syllables come from the clip's `cues`, so timing rewards need no waveform.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int, Integer
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.models.tokens import TokenLayout
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, AUDIO_TOKEN_RATE_HZ, CHUNK_SECONDS, MOTION_TOKENS_PER_CHUNK
from echoavatar_lab.models.generator.windows import TokenClip

Events = Literal["any", "beat", "stress"]


@dataclass(frozen=True)
class Prompt:
    """One prompt; times are seconds from the first frame of the continuation."""

    clip: str
    start: int  # chunk of the clip at which the past begins
    audio: Int[np.ndarray, "f l"]  # codec tokens of the past and the continuation
    past: Int[np.ndarray, "m p q"]
    truth: Int[np.ndarray, "n p q"]  # the clip's own continuation, if it `has_truth`
    domain: Integer[np.ndarray, " n"]  # one label for each motion token of the continuation
    beats: Float[np.ndarray, " i"]
    stresses: Float[np.ndarray, " j"]


class PromptBatch(NamedTuple):
    """Prompts as tensors, one a row."""

    audio: Int[Tensor, "b f l"]
    past: Int[Tensor, "b m p q"]

    def repeated(self, times: int) -> "PromptBatch":
        """Repeat each row `times` times, copies adjacent."""
        return PromptBatch(self.audio.repeat_interleave(times, 0), self.past.repeat_interleave(times, 0))

    def rows(self, which: slice) -> "PromptBatch":
        """A slice of the rows."""
        return PromptBatch(self.audio[which], self.past[which])


def batch_of(prompts: Sequence[Prompt], device: str = "cpu") -> PromptBatch:
    """Stack prompts, which must all have the same shape."""
    audio, past = (
        torch.from_numpy(np.stack([getattr(prompt, name) for prompt in prompts]).astype(np.int64)).to(device)
        for name in ("audio", "past")
    )
    return PromptBatch(audio, past)


def read_token_clips(
    folder: Path, layout: TokenLayout | None = None, *, needs_truth: bool = False
) -> dict[str, TokenClip]:
    """The token files of a folder by name, checked against the generator's vocabulary if `layout` is given.

    With `needs_truth` clips whose motion a generator made (`data rl-corpus`) are skipped. Raises MotionError if there
    are none, one is damaged, or its codes do not fit the vocabulary.
    """
    clips = {path.stem: TokenClip.load(path) for path in sorted(folder.glob("*.npz"))}
    if not clips:
        raise MotionError(f"{folder} holds no token files; make them with `echoavatar train tokens`")
    if layout is not None:
        wanted = (layout.motion_layers, layout.motion_codes, layout.audio_codes)
        for name, clip in clips.items():
            has = (clip.motion.shape[2], int(clip.motion.max(initial=0)) + 1, int(clip.audio.max(initial=0)) + 1)
            if has[0] != wanted[0] or has[1] > wanted[1] or has[2] > wanted[2]:
                raise MotionError(
                    f"{folder / name}.npz has {has[0]} motion layers, motion codes below {has[1]} and audio codes below"
                    f" {has[2]}; this generator has {wanted[0]}, {wanted[1]} and {wanted[2]}: tokenize with its own"
                    " codec and tokenizer"
                )
    if needs_truth:
        clips = {name: clip for name, clip in clips.items() if clip.has_truth}
    if not clips:
        raise MotionError(
            f"{folder} holds only motion that a generator made, which nothing can be measured against or learned from;"
            " give a folder made by `echoavatar train tokens`"
        )
    return clips


def train_and_test(clips: Mapping[str, TokenClip], folder: Path) -> tuple[dict[str, TokenClip], dict[str, TokenClip]]:
    """The clips of split train, and the others. Raises MotionError if none is of split train."""
    train = {name: clip for name, clip in clips.items() if clip.split == "train"}
    if not train:
        raise MotionError(f"{folder} holds no clip of split train, so there is nothing to learn from")
    return train, {name: clip for name, clip in clips.items() if clip.split != "train"}


class PromptSampler:
    """All prompts of some clips; a draw depends only on the seed and its number."""

    def __init__(
        self,
        clips: Mapping[str, TokenClip],
        *,
        past: int,
        length: int,
        seed: int = 0,
        fewest_events: int = 0,
        events: Events = "any",
    ) -> None:
        """Prompts of `past` + `length` chunks, with at least `fewest_events` events of one kind in the continuation."""
        self.past = past
        self._clips, self._length, self._seed = dict(clips), length, seed
        self._spots: list[tuple[str, int]] = []
        columns = {"any": (0, 1), "beat": (0,), "stress": (1,)}[events]
        for name, clip in self._clips.items():
            starts = np.arange(max(0, clip.chunks - past - length + 1))
            begin = (starts + past) * CHUNK_SECONDS
            times = [cue_times(clip, column) for column in columns]
            counts = [np.diff(np.searchsorted(own, [begin, begin + length * CHUNK_SECONDS]), axis=0) for own in times]
            self._spots += [(name, int(start)) for start in starts[np.max(counts, 0)[0] >= fewest_events]]
        if not self._spots:
            kind = {"any": "beats or stresses", "beat": "beats", "stress": "stresses"}[events]
            wanted = f" with {fewest_events} {kind}" if fewest_events else ""
            raise MotionError(
                f"no clip holds a prompt of {past} + {length} chunks{wanted}; use longer clips or shorter prompts"
            )

    def __len__(self) -> int:
        """Number of different prompts."""
        return len(self._spots)

    def draw(self, number: int, size: int) -> list[Prompt]:
        """`size` prompts of draw `number`, uniform over all."""
        random = np.random.default_rng([self._seed, number])
        return [self.cut(*self._spots[int(at)]) for at in random.integers(len(self), size=size)]

    def spread(self, size: int) -> list[Prompt]:
        """`size` prompts at even distances: the same ones every time."""
        at = np.linspace(0, len(self) - 1, min(size, len(self))).round().astype(int)
        return [self.cut(*self._spots[int(k)]) for k in at]

    def cut(self, name: str, start: int) -> Prompt:
        """The prompt whose past begins at chunk `start` of a clip.

        Raises MotionError if there is no such clip, or it is too short.
        """
        clip = self._clips.get(name)
        if clip is None:
            raise MotionError(f"no clip {name!r} among the {len(self._clips)} token files; use the folder it came from")
        if not 0 <= start <= clip.chunks - self.past - self._length:
            raise MotionError(
                f"clip {name!r} has {clip.chunks} chunks: no prompt of {self.past} + {self._length} begins at {start}"
            )
        begin, stop = start + self.past, start + self.past + self._length
        token = slice(begin * MOTION_TOKENS_PER_CHUNK, stop * MOTION_TOKENS_PER_CHUNK)
        beats, stresses = (
            times[(times >= 0) & (times < self._length * CHUNK_SECONDS)]
            for times in (cue_times(clip, column) - begin * CHUNK_SECONDS for column in (0, 1))
        )
        return Prompt(
            name,
            start,
            clip.audio[start * AUDIO_FRAMES_PER_CHUNK : stop * AUDIO_FRAMES_PER_CHUNK],
            clip.motion[start * MOTION_TOKENS_PER_CHUNK : begin * MOTION_TOKENS_PER_CHUNK],
            clip.motion[token],
            clip.domain[token],
            beats,
            stresses,
        )


def cue_times(clip: TokenClip, column: int) -> Float[np.ndarray, " n"]:
    """Seconds at which the cues of a column begin."""
    assert clip.cues is not None
    on = np.concatenate([[0], clip.cues[:, column].astype(np.int8)])
    return np.flatnonzero(np.diff(on) == 1) / AUDIO_TOKEN_RATE_HZ
