"""`echoavatar evaluate --codes`: what the tokenizer keeps of the truth, without a generator.

The true motion of held-out clips is encoded and decoded, and then sent through the stages behind the decoder. No
generator can be better in time than this. Not in the paper, which reports reconstruction errors alone.
"""

from collections.abc import Callable, Sequence

import torch

from echoavatar.data import Clip
from echoavatar.engine.pipeline.tokenize import clip_features
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import Motion, from_features
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.motion.stages.post import Post
from echoavatar.timing import FRAME_RATE_HZ

from . import behaviour
from .report import beat_scores, reconstruction_scores

Progress = Callable[[int, int], None]
TRUTH, DECODED, SHOWN = "truth", "decoded", "shown"


def true_codes(
    tokenizer: BodyTokenizer, clips: Sequence[Clip], *, progress: Progress | None = None
) -> dict[str, dict[str, float]]:
    """Excess of beat alignment over chance, on stresses and beats, of three motions: `truth`, `decoded` and `shown`.

    `decoded` are the true codes decoded; `shown` is that motion behind all later stages. `tokenizer` holds the errors
    of reconstruction.
    """
    post, skeleton = Post(tokenizer.skeleton), tokenizer.skeleton
    tracks: dict[str, list[behaviour.Track]] = {TRUTH: [], DECODED: [], SHOWN: []}
    for done, clip in enumerate(clips, 1):
        features = clip_features(tokenizer, clip)
        with torch.inference_mode():
            moved = from_features(skeleton, tokenizer.decode(tokenizer.encode(features[None]))[0])
        rotations = quaternion_from_matrix(moved.rotations).numpy()
        decoded = Motion(skeleton, rotations, moved.root.numpy(), FRAME_RATE_HZ)
        shown = post.replay(decoded)
        for name, motion in ((TRUTH, clip), (DECODED, decoded), (SHOWN, shown)):
            domain = clip.domain[: motion.frames]
            tracks[name].append(behaviour.track(skeleton, motion.rotations, motion.root, domain))
        if progress:
            progress(done, len(clips))
    found = {"tokenizer": reconstruction_scores(tokenizer, clips)}
    for name, made in tracks.items():
        scores = beat_scores(skeleton, clips, {"": made})
        found[name] = {
            f"{event}_excess": scores[f"ba_{event}"] - scores[f"ba_{event}_chance"] for event in ("onset", "beat")
        }
    return found
