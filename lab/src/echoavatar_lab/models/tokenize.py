"""Tokenize a corpus: audio and motion codes, on which the generator is trained.

Every clip is encoded continuously from its first sample, exactly as in a stream (level control, if the generator is
to run with it, then the codec). Its mirror image is encoded too: the same sound, with left and right of the motion
exchanged.

With a `dancer` the music is danced by a generator after the true past, and cut apart from the rest (`_danced`): who
learns from such files learns new speech and keeps the generator's dances, which were tuned after its training.

Sound that has no recorded motion becomes prompts of reinforcement learning (`tokenize_sounds`). A prompt needs past
motion. Here the generator that is to be tuned makes it, as in a live session. Such token files have `has_truth` false:
they are not used for reference statistics, reward models or generators.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from zlib import crc32

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from pydantic import Field
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from torch import Tensor

from echoavatar.config import Config
from echoavatar.errors import MotionError
from echoavatar.json_reader import read_object
from echoavatar.models.audio import LevelControl
from echoavatar.models.generator.manner import BUSY_S, HIGH_S, TOLD, Manner, busy, raised
from echoavatar.motion.kinematics import Motion, from_features
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.timing import (
    AUDIO_FRAMES_PER_CHUNK,
    AUDIO_TOKEN_RATE_HZ,
    FRAME_RATE_HZ,
    FRAMES_PER_MOTION_TOKEN,
    MOTION_TOKENS_PER_CHUNK,
    SAMPLES_PER_AUDIO_TOKEN,
)
from echoavatar_lab.data import DOMAINS, Clip, Corpus, Sound, SoundSet
from echoavatar_lab.data.clip import mirror_features
from echoavatar_lab.held_folder import hold_folder
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.codebook_training import steady_codes
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import whole_features
from echoavatar_lab.progress import Progress, watched

CUE_FRAMES = 3
LEAD_CHUNKS = 6


class TokenSettings(Config):
    """How a corpus is encoded; the generator that learns from it keeps both in its config."""

    patience: float = Field(default=0.4, ge=0, description="cost of changing a code (paper: 0, the nearest codes)")
    is_leveled: bool = Field(default=True, description="whether sound is brought to one loudness (paper: false)")
    is_mirrored: bool = Field(default=True, description="encode mirrored motion too (paper: for the alignment reward)")


def tokenize_corpus(
    corpus: Corpus,
    codec: AudioCodec,
    tokenizer: BodyTokenizer,
    folder: Path,
    *,
    is_mirrored_too: bool = True,
    patience: float = 0.0,
    is_leveled: bool = True,
    dancer: Generator | None = None,
    progress: Progress | None = None,
) -> int:
    """Write a token file for each clip and its mirror image, and return the number of files; existing ones are kept.

    With a `dancer` each becomes several (`_danced`), and one without a chunk that says that they are whole.

    With `patience` the motion codes are steady (`quantize.steadiest`), so that the generator has fewer changes to
    predict. `is_leveled`: see `audio_codes`. Clips without sound are skipped, because the generator would learn to
    dance to silence. Raises MotionError if no clip has sound, or the tokenizer was trained on another rig.
    """
    names = [entry.name for entry in corpus.entries(has_mirrored=False) if entry.has_sound]
    if not names:
        raise MotionError(f"no clip of {corpus.folder} has sound; the generator learns from pairs of sound and motion")
    if corpus.skeleton.names != tokenizer.skeleton.names:
        raise MotionError(
            f"{corpus.folder} is on a rig of {corpus.skeleton.joints} joints, the tokenizer on one of"
            f" {tokenizer.skeleton.joints}; train a tokenizer on this set, or prepare it with --rig unified"
        )
    with hold_folder(folder):
        for name in watched(names, progress):
            targets = [(name, False)] + ([(f"{name}.mirror", True)] if is_mirrored_too else [])
            if not all((folder / f"{target}.npz").exists() for target, _ in targets):
                clip = corpus.load(name)
                sound = audio_codes(codec, clip.audio, is_leveled=is_leveled)
                for target, is_mirrored in targets:
                    codes = motion_codes(tokenizer, clip, is_mirrored=is_mirrored, patience=patience)
                    domain = clip.domain[: len(codes) * FRAMES_PER_MOTION_TOKEN : FRAMES_PER_MOTION_TOKEN]
                    cues = cues_at(clip.events, len(sound))
                    manner = told_manner(clip, len(codes), is_mirrored=is_mirrored)
                    whole = TokenClip(
                        sound, codes, domain, clip.split, cues, patience, is_leveled=is_leveled, manner=manner
                    )
                    parts = [] if dancer is None else _danced(whole, dancer, seed=crc32(target.encode()))
                    for number, part in enumerate(parts):
                        part.save(folder / f"{target}.{number}.npz")
                    (whole if dancer is None else whole.cut(0, 0)).save(
                        folder / f"{target}.npz"
                    )  # the last: it is done
        return len(list(folder.glob("*.npz")))


@torch.inference_mode()
def _danced(clip: TokenClip, dancer: Generator, *, seed: int) -> list[TokenClip]:
    """The clip in parts: each stretch of music with the dancer's motion behind a true past, and what is between them.

    Between them all is true, with the last `LEAD_CHUNKS` of a true dance in front, so that its end is learned too. The
    dancer draws from its whole distribution, so that who learns from it can be cooled as it is.
    """
    dancer.config = dancer.config.model_copy(update={"temperature": 1.0, "cooling": 1.0, "top_p": 1.0})
    stream = open_stream(dancer)
    of_chunk = clip.domain[: clip.chunks * MOTION_TOKENS_PER_CHUNK].reshape(clip.chunks, -1)
    is_music = np.concatenate([[False], (of_chunk == DOMAINS.index("music")).all(1), [False]])
    borders = np.flatnonzero(np.diff(is_music)).reshape(-1, 2)
    parts, free = [], 0
    for start, stop in borders:
        parts.append(clip.cut(free, start))
        free = max(start, stop - LEAD_CHUNKS)
        first = max(0, start - dancer.config.window_chunks)
        part, state, one = clip.cut(first, stop), stream.init_state(1), torch.ones(1, dtype=torch.bool)
        sound, moves = (torch.from_numpy(codes[None].astype(np.int64)) for codes in (part.audio, part.motion))
        heard, known = (start - first) * AUDIO_FRAMES_PER_CHUNK, (start - first) * MOTION_TOKENS_PER_CHUNK
        if heard:
            stream.prime(sound[:, :heard], moves[:, :known], state, one)  # type: ignore[arg-type]
        danced = stream.step(sound[:, heard:], state, one, seeds=torch.tensor([seed + start]))  # type: ignore[arg-type]
        parts.append(replace(part, motion=np.concatenate([part.motion[:known], danced[0].numpy().astype(np.int16)])))
    return [part for part in (*parts, clip.cut(free, clip.chunks)) if part.chunks]


def told_manner(clip: Clip, tokens: int, *, is_mirrored: bool) -> Float[np.ndarray, "n m"] | None:
    """The manner of the clip's label at each motion token, how busy and how high hands are; in the mirror hands swap.

    Hands are told where somebody talks or listens: those of a dance are NaN.
    """
    if "manner" not in clip.labels:
        return None
    told = Manner(**read_object(clip.labels["manner"].encode(), f"the manner of {clip.name}"))
    speeds, heights = hands_of(clip.motion())
    at = np.minimum(np.arange(tokens) * FRAMES_PER_MOTION_TOKEN + FRAMES_PER_MOTION_TOKEN // 2, len(speeds) - 1)
    mean = [
        uniform_filter1d(part, round(span * FRAME_RATE_HZ), axis=0, mode="nearest")[at]
        for part, span in ((speeds, BUSY_S), (heights, HIGH_S))
    ]
    hands = np.concatenate([busy(mean[0]), raised(mean[1])], 1)
    hands[clip.domain[np.minimum(at, len(clip.domain) - 1)] == DOMAINS.index("music")] = np.nan
    if is_mirrored:
        told, hands = replace(told, right=1 - told.right), hands[:, [1, 0, 3, 2]]
    found = np.concatenate([np.tile(np.array(told.values), (tokens, 1)), hands], 1).astype(np.float32)
    assert found.shape[1] == len(TOLD)
    return found


def hands_of(motion: Motion) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, "t 2"]]:
    """Speeds and heights of the left and the right wrist in the shoulders' frame, in arm lengths (per second)."""
    at = dict(zip(motion.skeleton.names, motion.pose().positions.swapaxes(0, 1), strict=True))
    shoulder, elbow, wrist = (at[f"left{bone}"] for bone in ("UpperArm", "LowerArm", "Hand"))
    reach = np.median(np.linalg.norm(shoulder - elbow, axis=1) + np.linalg.norm(elbow - wrist, axis=1))
    across = shoulder - at["rightUpperArm"]
    away = np.stack([wrist, at["rightHand"]], 1) - ((shoulder + at["rightUpperArm"]) / 2)[:, None]
    x, z = across[:, None, 0], across[:, None, 2]
    wide = np.hypot(x, z) + 1e-9
    local = np.stack(
        [(x * away[..., 0] + z * away[..., 2]) / wide, away[..., 1], (x * away[..., 2] - z * away[..., 0]) / wide], -1
    )
    smooth = gaussian_filter1d(local / reach, 1, axis=0)
    return np.linalg.norm(np.gradient(smooth, axis=0), axis=-1) * motion.fps, local[..., 1] / reach


@torch.inference_mode()
def audio_codes(
    codec: AudioCodec, audio: Float[np.ndarray, " s"], *, is_leveled: bool = True
) -> Int[np.ndarray, "f 2"]:
    """Codes of a whole clip of 24 kHz audio, as in a stream.

    `is_leveled` must be as in the pipeline that runs the generator (`Runtime.level_control`); the paper has no level
    control.
    """
    usable = len(audio) // SAMPLES_PER_AUDIO_TOKEN * SAMPLES_PER_AUDIO_TOKEN
    heard = audio[None, :usable].copy()
    if is_leveled:
        heard = LevelControl()(heard)
    return codec.encode(torch.from_numpy(heard).to(codec.codebooks.device))[0].cpu().numpy().astype(np.int16)


def cues_at(events: Mapping[str, Float[np.ndarray, " n"]], frames: int) -> UInt8[np.ndarray, "f 2"]:
    """1 in the three audio frames (40 ms) after each beat and each stressed vowel's onset; event times in seconds."""
    cues = np.zeros((frames, 2), np.uint8)
    for column, name in enumerate(("beats", "stress")):
        first = np.asarray(events.get(name, np.zeros(0)) * AUDIO_TOKEN_RATE_HZ).astype(int)
        for later in range(CUE_FRAMES):
            at = first + later
            cues[at[(at >= 0) & (at < frames)], column] = 1
    return cues


@torch.inference_mode()
def motion_codes(
    tokenizer: BodyTokenizer, clip: Clip, *, is_mirrored: bool = False, patience: float = 0.0
) -> Int[np.ndarray, "n 3 q"]:
    """Codes of a whole clip of motion."""
    features = whole_features(tokenizer.skeleton, clip)
    if is_mirrored:
        features = mirror_features(tokenizer.skeleton, features)
    return steady_codes(tokenizer, features[None], patience)[0].numpy().astype(np.int16)


@torch.inference_mode()
def motion_of_codes(tokenizer: BodyTokenizer, codes: Int[Tensor, "n p q"]) -> Motion:
    """The motion of codes on any device, decoded on the tokenizer's rig; nothing behind the decoder runs."""
    decoded = tokenizer.decode(codes[None].to(tokenizer.mean.device))[0].cpu()
    frames = from_features(tokenizer.skeleton, decoded.numpy())
    rotations = quaternion_from_matrix(frames.rotations)
    return Motion(tokenizer.skeleton, rotations, frames.root, float(FRAME_RATE_HZ))


def tokenize_sounds(
    sounds: SoundSet,
    codec: AudioCodec,
    generator: Generator,
    folder: Path,
    *,
    seed: int = 0,
    has_past: bool = True,
    progress: Progress | None = None,
) -> int:
    """Write a token file for each sound and return the number of sounds; existing files are kept.

    Without `has_past` no motion is made and all its codes are 0: for prompts without a past, which read none. Raises
    AudioError if a sound's file is missing or damaged.
    """
    with hold_folder(folder):
        for sound in watched(sounds.sounds, progress):
            path = folder / f"{sound.name}.npz"
            if not path.exists():
                _clip(sounds, sound, codec, generator, seed if has_past else None).save(path)
        return len(sounds.sounds)


def _clip(sounds: SoundSet, sound: Sound, codec: AudioCodec, generator: Generator, seed: int | None) -> TokenClip:
    audio = audio_codes(codec, sounds.load(sound), is_leveled=generator.config.is_leveled)
    events = {kind: np.array(times) for kind, times in sound.events.items()}
    layout = generator.config.layout
    tokens = len(audio) // (AUDIO_TOKEN_RATE_HZ * FRAMES_PER_MOTION_TOKEN // FRAME_RATE_HZ)
    return TokenClip(
        audio,
        np.zeros((tokens, layout.parts, layout.motion_layers), np.int16)
        if seed is None
        else own_motion(generator, audio, seed=seed ^ crc32(sound.name.encode())),
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
