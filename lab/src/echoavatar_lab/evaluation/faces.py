"""Lip-sync measures of a face model, on speech with known phones and on recordings.

Not in the paper, which shows faces but does not measure them.

- `mouth_pearson`: correlation of mouth opening (jaw minus lip closure) with the truth, over frames of speech.
- `lip_lag_frames`: the shift in whole frames at which that correlation is highest; positive: lips are late.
- `closed_on_pbm`: share of p, b and m during which the mouth closes (opening at most `CLOSED`), a frame before and
  after included. For comparison: how often the mouth is closed at other times by chance, and the truth's share.
- `silent_motion`: mean change of the opening per frame in silences over half a second, over that in speech.
- `face_mse`, m2, and `face_lvd`, m a frame: errors of the character's vertices over all frames (`metrics.face_errors`).
- `envelope_pearson`: correlation of the opening with the loudness of recorded speech, which has no truth.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from echoavatar.engine.pipeline import Bundle
from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import LevelControl
from echoavatar.models.face import FaceStream
from echoavatar.models.face.idle import frame_loudness
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar_lab.corpora.rehearsal.track import compose_track
from echoavatar_lab.corpora.sound import SoundTrack
from echoavatar_lab.corpora.speech.lips import lip_curves
from echoavatar_lab.progress import Progress, watched

from .metrics.face_errors import errors_on_mesh

CLOSED = 0.05  # share of the jaw's full opening at which lips touch
CLOSING_PHONES = ("p", "b", "m", "em")
MOST_LAG_FRAMES = 8
_SETTLE_S = 0.5  # start of a silence in which the mouth may still come to rest

Opening = Float[np.ndarray, " t"]


class FaceScores(NamedTuple):
    """Measures over several clips; NaN if there was nothing to measure."""

    mouth_pearson: float
    lip_lag_frames: int
    closed_on_pbm: float
    closed_on_pbm_truth: float
    closed_elsewhere: float
    silent_motion: float
    face_mse: float
    face_lvd: float
    envelope_pearson: float


def evaluate_face(
    bundle: Bundle,
    tracks: Sequence[SoundTrack],
    recordings: Sequence[Float[np.ndarray, " _"]] = (),
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> FaceScores:
    """Animate the face to tracks with known phones and to recordings (24 kHz), and measure it.

    Raises EchoAvatarError if the bundle has no face model.
    """
    if bundle.face is None:
        raise EchoAvatarError(f"bundle {bundle.name} has no face model; train one (`echoavatar train face`)")
    stream = bundle.face.stream()
    made, truths, envelopes, errors = [], [], [], []
    heard: list[SoundTrack | np.ndarray] = [*tracks, *recordings]
    for one in watched(heard, progress):
        if isinstance(one, SoundTrack):
            true = lip_curves(one, ARKIT_NAMES)
            own = animate_face(stream, one.audio, seed=seed)[: len(true)]
            truths.append(opening(true))
            made.append(opening(own))
            errors.append(errors_on_mesh(own, true))
        else:
            envelopes.append(_envelope_pearson(opening(animate_face(stream, one, seed=seed)), one))
    spoken = [_spoken(track, len(truth)) for track, truth in zip(tracks, truths, strict=True)]
    still = [_silent(track, len(truth)) for track, truth in zip(tracks, truths, strict=True)]
    pearsons = [_shifted_pearson(made, truths, spoken, lag) for lag in range(-MOST_LAG_FRAMES, MOST_LAG_FRAMES + 1)]
    closing = [_closing(track, len(truth)) for track, truth in zip(tracks, truths, strict=True)]
    return FaceScores(
        mouth_pearson=pearsons[MOST_LAG_FRAMES],
        lip_lag_frames=int(np.argmax(pearsons)) - MOST_LAG_FRAMES,
        closed_on_pbm=_share_closed(made, closing),
        closed_on_pbm_truth=_share_closed(truths, closing),
        closed_elsewhere=_share_closed(made, [_moved(spans, len(m)) for spans, m in zip(closing, made, strict=True)]),
        silent_motion=_motion(made, still) / _motion(made, spoken),
        face_mse=float(np.mean([mse for mse, _ in errors])) if errors else float("nan"),
        face_lvd=float(np.mean([lvd for _, lvd in errors])) if errors else float("nan"),
        envelope_pearson=float(np.mean(envelopes)) if envelopes else float("nan"),
    )


def held_out_tracks(count: int) -> list[SoundTrack]:
    """Half minutes of speech with pauses, of sentences that are not in the training data."""
    return [compose_track(4_711 + index, 30.0, mix="speech", split="test") for index in range(count)]


def animate_face(stream: FaceStream, audio: Float[np.ndarray, " s"], *, seed: int) -> Float[np.ndarray, "t 52"]:
    """Face curves for a whole recording (24 kHz mono), with level control as in the pipeline."""
    step = stream.config.step * SAMPLES_PER_FRAME
    padded = np.pad(audio, (0, -len(audio) % step)).astype(np.float32)
    heard = LevelControl()(padded[None])
    curves = stream.step(heard, stream.init_state(1), np.ones(1, np.bool_), np.array([seed]))
    return np.asarray(curves[0, : -(-len(audio) // SAMPLES_PER_FRAME)])


def opening(curves: Float[np.ndarray, "t 52"]) -> Opening:
    """Distance of the lips: the jaw's opening minus the lips' closure."""
    apart = curves[:, ARKIT_NAMES.index("jawOpen")] - curves[:, ARKIT_NAMES.index("mouthClose")]
    return np.asarray(np.maximum(apart, 0))


def _spoken(track: SoundTrack, frames: int) -> Bool[np.ndarray, " t"]:
    inside = np.zeros(frames, bool)
    for start, end in track.phrases:
        inside[int(start * FRAME_RATE_HZ) : int(end * FRAME_RATE_HZ)] = True
    return inside


def _silent(track: SoundTrack, frames: int) -> Bool[np.ndarray, " t"]:
    """Frames of silence, without the first half second after speech and the last frame before it."""
    edges = [0.0, *(time for phrase in track.phrases for time in phrase), track.seconds]
    inside = np.zeros(frames, bool)
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        inside[int((start + _SETTLE_S) * FRAME_RATE_HZ) : max(0, int(end * FRAME_RATE_HZ) - 1)] = True
    return inside


def _closing(track: SoundTrack, frames: int) -> list[tuple[int, int]]:
    """Frame ranges of each p, b and m, extended by a frame on either side."""
    spans = []
    for start, end, name in track.phones:
        first, last = int(start * FRAME_RATE_HZ) - 1, int(end * FRAME_RATE_HZ) + 2
        if name in CLOSING_PHONES and first >= 0 and last <= frames:
            spans.append((first, last))
    return spans


def _moved(spans: Sequence[tuple[int, int]], frames: int) -> list[tuple[int, int]]:
    """The same ranges a third of a second later, as the chance level."""
    return [(a + 10, b + 10) for a, b in spans if b + 10 <= frames]


def _share_closed(openings: Sequence[Opening], spans: Sequence[Sequence[tuple[int, int]]]) -> float:
    hits = [mouth[a:b].min() <= CLOSED for mouth, own in zip(openings, spans, strict=True) for a, b in own]
    return float(np.mean(hits)) if hits else float("nan")


def _shifted_pearson(
    made: Sequence[Opening], truths: Sequence[Opening], where: Sequence[Bool[np.ndarray, " t"]], lag: int
) -> float:
    """Correlation of the truth with the generated opening `lag` frames later."""
    ours = np.concatenate([np.roll(m, -lag)[w] for m, w in zip(made, where, strict=True)])
    theirs = np.concatenate([t[w] for t, w in zip(truths, where, strict=True)])
    return float(np.corrcoef(ours, theirs)[0, 1])


def _motion(openings: Sequence[Opening], where: Sequence[Bool[np.ndarray, " t"]]) -> float:
    steps = [np.abs(np.diff(mouth))[w[1:]] for mouth, w in zip(openings, where, strict=True)]
    together = np.concatenate(steps)
    return float(together.mean()) if len(together) else float("nan")


def _envelope_pearson(mouth: Opening, audio: Float[np.ndarray, " s"]) -> float:
    loud = frame_loudness(audio[None, : len(audio) // SAMPLES_PER_FRAME * SAMPLES_PER_FRAME])[0]
    smooth = [gaussian_filter1d(curve[: len(loud)].astype(float), 2.0) for curve in (mouth, loud)]
    return float(np.corrcoef(*smooth)[0, 1])
