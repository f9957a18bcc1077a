"""`echoavatar evaluate --codes`: what is lost of the truth's timing and size between its motion and what is shown.

The true motion of held-out clips is encoded and decoded, and then sent through the stages behind the decoder. No
generator can be better in time than this. Then the generator draws each chunk after the true past: what is lost here is
lost in a single chunk, however well a performance keeps its phase. Not in the paper, which reports errors of
reconstruction alone.
"""

from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from echoavatar.engine.pipeline import Bundle
from echoavatar.models.generator import Generator, open_stream
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import Motion, Skeleton, from_features
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.motion.stages.post import Post
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.data import Clip
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenize import clip_features

from . import behaviour
from .behaviour import MUSIC, Track
from .metrics.liveliness import POINTS, shoulder_turn_deg
from .metrics.physical import jerk_m_s3
from .reliance import token_clips
from .report import beat_scores, reconstruction_scores

Progress = Callable[[int, int], None]
TRUTH, DECODED, SHOWN, DRAWN = "truth", "decoded", "shown", "drawn"
SHORTEST_DANCE_S = 14


def true_codes(
    bundle: Bundle,
    clips: Sequence[Clip],
    *,
    tokenizer: BodyTokenizer | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, dict[str, float]]:
    """Excess of beat alignment over chance on stresses and beats, jerk (m/s3) and turn in dance, of several motions.

    `truth` is the clips' own, `decoded` its codes decoded, `shown` that motion behind all later stages, and `drawn` the
    codes that the generator draws for each chunk after the true past, decoded. With another `tokenizer` than the
    bundle's, whose codes the generator does not know, nothing is drawn. `tokenizer` holds the errors of reconstruction.
    """
    others, tokenizer = tokenizer is not None, tokenizer or bundle.tokenizer
    post = Post(tokenizer.skeleton)
    tracks: dict[str, list[behaviour.Track]] = {
        name: [] for name in (TRUTH, DECODED, SHOWN, *([] if others else [DRAWN]))
    }
    for done, clip in enumerate(clips, 1):
        decoded = _decoded(tokenizer, tokenizer.encode(clip_features(tokenizer, clip)[None]))
        motions: dict[str, Clip | Motion] = {TRUTH: clip, DECODED: decoded, SHOWN: post.replay(decoded)}
        if not others:
            [tokens] = token_clips(bundle, [clip])
            motions[DRAWN] = _decoded(tokenizer, drawn_after_truth(bundle.generator, tokens, seed=seed + done)[None])
        for name, motion in motions.items():
            domain = clip.domain[: motion.frames]
            tracks[name].append(behaviour.track(tokenizer.skeleton, motion.rotations, motion.root, domain))
        if progress:
            progress(done, len(clips))
    found = {"tokenizer": reconstruction_scores(tokenizer, clips)}
    for name, made in tracks.items():
        scores = beat_scores(tokenizer.skeleton, clips, {"": made})
        found[name] = {
            f"{event}_excess": scores[f"ba_{event}"] - scores[f"ba_{event}_chance"] for event in ("onset", "beat")
        } | {
            "jerk_m_s3": float(np.mean([jerk_m_s3(each.positions) for each in made])),
            "dance_turn_deg": dance_turn_deg(tokenizer.skeleton, made),
        }
    return found


def dance_turn_deg(skeleton: Skeleton, tracks: Sequence[Track]) -> float:
    """Mean deviation of the shoulders' turn against the hips over stretches of music of 14 s; NaN where none is."""
    at, turns = skeleton.indices(POINTS), []
    for track in tracks:
        is_music = np.pad(track.domain == MUSIC, 1)
        for start, end in np.flatnonzero(np.diff(is_music)).reshape(-1, 2):
            if end - start >= SHORTEST_DANCE_S * FRAME_RATE_HZ:
                turns.append(shoulder_turn_deg(track.positions[start:end, at]))
    return float(np.mean(turns)) if turns else float("nan")


@torch.no_grad()
def drawn_after_truth(generator: Generator, tokens: TokenClip, *, seed: int = 0) -> Int[Tensor, "n p q"]:
    """The codes that a generator draws for each chunk of a clip when all chunks before have the true ones."""
    stream: Any = open_stream(generator)
    row = torch.ones(1, dtype=torch.bool)
    audio, motion = (torch.from_numpy(codes).long()[None] for codes in (tokens.audio, tokens.motion))
    sounds, moves = (codes.tensor_split(tokens.chunks, dim=1) for codes in (audio, motion))
    state, made = stream.init_state(1), []
    for sound, moved in zip(sounds, moves, strict=True):
        made.append(stream.step(sound, deepcopy(state), row, seeds=torch.tensor([seed])))
        stream.prime(sound, moved, state, row)
    return torch.cat(made, dim=1)[0]


def _decoded(tokenizer: BodyTokenizer, codes: Int[Tensor, "1 n p q"]) -> Motion:
    with torch.inference_mode():
        moved = from_features(tokenizer.skeleton, tokenizer.decode(codes)[0])
    rotations = quaternion_from_matrix(moved.rotations).numpy()
    return Motion(tokenizer.skeleton, rotations, moved.root.numpy(), FRAME_RATE_HZ)
