"""Training windows: whole chunks cut from clips that were encoded as one stream, as in a live session.

A token file is one clip: an npz with `audio_codes` (f, 2) int16 at 75 Hz, `motion_codes` (n, 3, Q) int16 at 7.5 Hz,
`domain` (n,) uint8 (0 silence, 1 speech, 2 music) and `split` ("train" or "test"); optionally `cues` (f, 2) uint8, 1
where a beat or a stressed syllable is heard, `patience`, how steady the codes of motion are, `is_leveled`, whether the
sound was brought to one loudness, `manner` (n, 13) float32, how its speaker gestures (`TOLD`), and `has_truth`, false
where the sound has no recorded motion and the codes are a generator's own (prompts for reinforcement learning).

Token corruption, uniform and hierarchical, is as in the paper's appendix (Corruption-based Quality Ordering). It is
used on the context motion tokens in training (Hierarchical Token Corruption against conditional collapse) and to grade
motion quality. Draws come from the generator alone. The body parts are corrupted independently of each other: the paper
defines one RVQ token grid of T x Q and does not say how three parts share it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.models.generator.manner import TOLD
from echoavatar.models.tokens import UPPER
from echoavatar.motion.formats.tables import NPZ_ERRORS, NpzArrays
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK
from echoavatar.whole_file import whole_file

from .sequences import Exemplar

CUES = ("beat", "stress")
DROPPED = (0.1, 0.2)  # share of a set that is left out in training (ours)
SHORTEST_CHUNKS = 3  # a set is drawn from at least 0.8 s


@dataclass(frozen=True)
class TokenClip:
    """One clip as codes, cut to whole chunks."""

    audio: Int[np.ndarray, "f layers"]
    motion: Int[np.ndarray, "n p q"]
    domain: UInt8[np.ndarray, " labels"]
    split: str = "train"
    cues: UInt8[np.ndarray, "f 2"] | None = None  # not known where None
    patience: float = 0.0  # how steady the codes of motion are (`quantize.steadiest`)
    has_truth: bool = True  # whether the motion is true, or a generator's own
    is_leveled: bool = True  # whether the sound was brought to one loudness first
    manner: Float[np.ndarray, "n m"] | None = None  # how its speaker gestures (`TOLD`); NaN where not known

    def __post_init__(self) -> None:
        chunks = min(len(self.audio) // AUDIO_FRAMES_PER_CHUNK, len(self.motion) // MOTION_TOKENS_PER_CHUNK)
        cues = np.zeros((len(self.audio), len(CUES)), np.uint8) if self.cues is None else self.cues
        object.__setattr__(self, "cues", cues[: chunks * AUDIO_FRAMES_PER_CHUNK])
        if self.manner is None:
            object.__setattr__(self, "manner", np.full((len(self.motion), len(TOLD)), np.nan, np.float32))
        object.__setattr__(self, "audio", self.audio[: chunks * AUDIO_FRAMES_PER_CHUNK])
        object.__setattr__(self, "motion", self.motion[: chunks * MOTION_TOKENS_PER_CHUNK])
        object.__setattr__(self, "domain", self.domain[: chunks * MOTION_TOKENS_PER_CHUNK])
        object.__setattr__(self, "manner", np.asarray(self.manner)[: chunks * MOTION_TOKENS_PER_CHUNK])

    @property
    def chunks(self) -> int:
        """Whole chunks of 8 frames."""
        return len(self.motion) // MOTION_TOKENS_PER_CHUNK

    def cut(self, start: int, stop: int) -> Self:
        """The chunks from `start` to `stop`."""
        sound = slice(start * AUDIO_FRAMES_PER_CHUNK, stop * AUDIO_FRAMES_PER_CHUNK)
        moves = slice(start * MOTION_TOKENS_PER_CHUNK, stop * MOTION_TOKENS_PER_CHUNK)
        cues, manner = np.asarray(self.cues)[sound], np.asarray(self.manner)[moves]
        motion, domain = self.motion[moves], self.domain[moves]
        return replace(self, audio=self.audio[sound], motion=motion, domain=domain, cues=cues, manner=manner)

    def heard_ahead(self, chunks: int) -> Self:
        """The clip with its sound this many chunks early: a motion token lies beside later sound and cues.

        The last `chunks` chunks of motion are dropped, because their sound would lie behind the end.
        """
        first = chunks * AUDIO_FRAMES_PER_CHUNK
        cues = None if self.cues is None else self.cues[first:]
        return replace(self, audio=self.audio[first:], cues=cues)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a token file. Raises MotionError if the file is missing, damaged or lacks an array."""
        try:
            with NpzArrays(path, MotionError) as file:
                cues, patience = file.get("cues"), float(file.get("patience", 0.0))
                codes = file["audio_codes"], file["motion_codes"], file["domain"]
                has_truth, is_leveled = (bool(file.get(name, True)) for name in ("has_truth", "is_leveled"))
                split, manner = str(file["split"]), file.get("manner")
                return cls(*codes, split, cues, patience, has_truth, is_leveled, manner)
        except NPZ_ERRORS as error:
            raise MotionError(f"{path} is not a token file ({error}); tokenize the corpus again") from error

    def save(self, path: Path) -> None:
        """Write a token file, whole or not at all."""
        with whole_file(path, error=MotionError) as partial, partial.open("wb") as file:
            np.savez_compressed(
                file,
                audio_codes=self.audio.astype(np.int16),
                motion_codes=self.motion.astype(np.int16),
                domain=self.domain.astype(np.uint8),
                split=np.array(self.split),
                cues=np.asarray(self.cues),
                patience=np.array(self.patience),
                has_truth=np.array(self.has_truth),
                is_leveled=np.array(self.is_leveled),
                manner=np.asarray(self.manner, np.float32),
            )


def shared_encoding(clips: Sequence[TokenClip]) -> dict[str, Any]:
    """The `patience` and `is_leveled` that all clips share; {} without clips.

    Raises MotionError if the clips differ in one.
    """
    patience, leveled = sorted({clip.patience for clip in clips}), {clip.is_leveled for clip in clips}
    if len(patience) > 1:
        raise MotionError(f"the token files have codes of patience {patience}; make all with one `--patience`")
    if len(leveled) > 1:
        raise MotionError("some token files hear levelled sound, others do not; make all with or without `--no-level`")
    return {"patience": patience[0], "is_leveled": leveled.pop()} if clips else {}


class Window(NamedTuple):
    """A batch of windows of codes."""

    audio: Int[Tensor, "b f l"]
    motion: Int[Tensor, "b n p q"]
    domain: Int[Tensor, "b n"]
    cues: Int[Tensor, "b f 2"]
    manner: Float[Tensor, "b n m"]  # `TOLD`; NaN where not known


class WindowSampler:
    """Draws windows of `chunks` chunks at chunk borders; a batch depends on the seed and its number alone."""

    def __init__(self, clips: Sequence[TokenClip], *, chunks: int, seed: int = 0) -> None:
        self._clips = [clip for clip in clips if clip.chunks >= chunks]
        if not self._clips:
            raise MotionError(
                f"no clip is as long as a training window of {chunks} chunks; use longer clips or shorter windows"
            )
        self._chunks, self._seed = chunks, seed
        starts = np.array([clip.chunks - chunks + 1 for clip in self._clips])
        self._ends = starts.cumsum()

    def __len__(self) -> int:
        """How many different windows there are."""
        return int(self._ends[-1])

    @property
    def most_per_clip(self) -> int:
        """Most windows that `grid` takes from one clip."""
        return max(clip.chunks // self._chunks for clip in self._clips)

    def batch(self, number: int, size: int) -> Window:
        """Batch `number` of `size` windows, uniform over all windows."""
        rng = np.random.default_rng([self._seed, number])
        return self._gather([self._locate(int(at)) for at in rng.integers(len(self), size=size)])

    def grid(self, size: int) -> list[Window]:
        """All windows without overlap, in order, in batches of up to `size`."""
        spots = [
            (clip, start)
            for clip in range(len(self._clips))
            for start in range(0, self._clips[clip].chunks - self._chunks + 1, self._chunks)
        ]
        return [self._gather(spots[at : at + size]) for at in range(0, len(spots), size)]

    def _locate(self, at: int) -> tuple[int, int]:
        clip = int(np.searchsorted(self._ends, at, side="right"))
        return clip, at - (int(self._ends[clip - 1]) if clip else 0)

    def _gather(self, spots: Sequence[tuple[int, int]]) -> Window:
        def cut(name: str, each: int, kind: type = np.int64) -> Tensor:
            parts = [
                getattr(self._clips[clip], name)[start * each : (start + self._chunks) * each] for clip, start in spots
            ]
            return torch.from_numpy(np.stack(parts).astype(kind))

        return Window(
            cut("audio", AUDIO_FRAMES_PER_CHUNK),
            cut("motion", MOTION_TOKENS_PER_CHUNK),
            cut("domain", MOTION_TOKENS_PER_CHUNK),
            cut("cues", AUDIO_FRAMES_PER_CHUNK),
            cut("manner", MOTION_TOKENS_PER_CHUNK, np.float32),
        )


def corrupt_uniformly(
    codes: Int[Tensor, "b n p q"], rate: float | Float[Tensor, " b"], *, codebook: int, generator: torch.Generator
) -> Int[Tensor, "b n p q"]:
    """Replace each code with probability `rate` (one, or one per row) by one drawn from 0..`codebook` - 1."""
    rates = torch.as_tensor(rate).expand(len(codes))
    chosen = torch.rand(codes.shape, generator=generator) < rates[:, None, None, None]
    return _replace(codes, chosen, codebook, generator)


def corrupt_hierarchically(
    codes: Int[Tensor, "b n p q"], rate: float | Float[Tensor, " b"], *, codebook: int, generator: torch.Generator
) -> Int[Tensor, "b n p q"]:
    """Replace, in floor(rate x n) time steps of each row and part, all layers from a random depth on.

    The depth q* is uniform over 0..Q-1 for each chosen time step; layers q >= q* are drawn uniformly, coarser ones
    stay. `rate` is one number or one per row (b,).
    """
    rows, steps, parts, layers = codes.shape
    rates = torch.as_tensor(rate, dtype=torch.float64).expand(rows)
    count = (rates * steps + 1e-9).floor().long()  # |S| = floor(rho T), robust to 0.3 * 10 = 2.999...
    order = torch.rand(rows, steps, parts, generator=generator).argsort(dim=1).argsort(dim=1)
    selected = order < count[:, None, None]
    depth = torch.randint(layers, (rows, steps, parts, 1), generator=generator)
    deep = torch.arange(layers) >= depth
    return _replace(codes, selected[..., None] & deep, codebook, generator)


def _replace(
    codes: Int[Tensor, "b n p q"], chosen: Bool[Tensor, "b n p q"], codebook: int, generator: torch.Generator
) -> Int[Tensor, "b n p q"]:
    noise = torch.randint(codebook, codes.shape, generator=generator, dtype=codes.dtype)
    return torch.where(chosen, noise, codes)


def draw_exemplar(
    motion: Int[Tensor, "b n p q"], share: float, *, codes: int, whole: bool, generator: torch.Generator
) -> Exemplar:
    """Directives for training windows: the codes that a span of each window uses, 10 to 20 % of them dropped.

    A `share` of the windows gets one, over a random span of whole chunks (over the `whole` window in the prefix order).
    """
    rows, steps = motion.shape[:2]
    chunks = steps // MOTION_TOKENS_PER_CHUNK
    length = torch.randint(min(SHORTEST_CHUNKS, chunks), chunks + 1, (rows, 1), generator=generator)
    start = (torch.rand(rows, 1, generator=generator) * (chunks - length + 1)).long()
    given = torch.rand(rows, 1, generator=generator) < share
    low, high = DROPPED
    dropped = low + (high - low) * torch.rand(rows, 1, generator=generator)
    kept = torch.rand(rows, codes, generator=generator) >= dropped
    if whole:
        start, length = torch.zeros_like(start), torch.full_like(length, chunks)
    chunk = torch.arange(steps) // MOTION_TOKENS_PER_CHUNK
    holds = (chunk >= start) & (chunk < start + length) & given
    used = torch.zeros(rows, codes + 1)  # the last column takes the codes outside the span
    used.scatter_(1, torch.where(holds, motion[:, :, UPPER, 0], codes), 1.0)
    return Exemplar(used[:, :codes] * kept, holds)
