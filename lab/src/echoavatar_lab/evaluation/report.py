"""The rows of the table: of generated beside true motion (`score`), of a bundle (`evaluate`), and of retrieval.

A bundle performs held-out clips, which have true motion to compare with, and recordings, which have none and show
whether the behaviour carries over.
"""

import zipfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int

from echoavatar.engine.pipeline import Bundle, Pipeline
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.motion.formats.tables import NpzArrays
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, ChunkSize
from echoavatar_lab.data import DOMAINS, MUSIC, SILENCE, SPEECH, Clip
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.models.fingers.clips import on_our_rig
from echoavatar_lab.progress import Progress, watched

from .beat_rows import ClipAudio, alignment_row, at_rate, dance_rows, event_rows, gesture_rows
from .codes import error_rows, reconstruction_rows, reliance, reliance_rows, token_clips
from .measures import (
    UNITS,
    ClipMeasurements,
    Extractor,
    Track,
    border_ratio,
    border_speed_ratio,
    by_domain,
    clip_statistics,
    hand_speed_m_s,
    leg_energy,
    measure_clip,
    stretches,
    track,
)
from .metrics.beat_alignment import ARM_JOINTS, dance_beats, gesture_beats, music_beats, speech_onsets
from .metrics.dance_features import LONGEST_S, RATE_HZ, geometric, kinetic, smpl_positions
from .metrics.distributions import Moments, frechet_between, moments, pooled, scaled_by_truth
from .metrics.liveliness import STATISTICS, windows
from .metrics.positions import Reconstruction, reconstruction
from .metrics.retrieval import PAPER_GALLERY, Consistency, chance, ranks, similarity, style_consistency
from .metrics.semantic import read_labels, srgr
from .motion_folder import Pair
from .table import Interval, Row, interval, mean_rows, row_of_means
from .takes import Sound, perform

FID_SAMPLES = 300
MIN_FRAMES = 8
SEED_STRIDE = 100  # difference between the seeds of two performances
SHOWN_KS = (1, 5, 10)
Features = Float[np.ndarray, "n d"]


# ---- motion beside true motion


def score(
    pairs: Sequence[Pair], extractor: Extractor | None, *, seed: int = 0, progress: Progress | None = None
) -> list[Row]:
    """All rows; without audio those that need it are left out, without an extractor FID.

    Raises MotionError if there is no clip, or one is too short.
    """
    if not pairs:
        raise MotionError("there is no clip to score; give folders with motion")
    made, true = [], []
    for pair in watched(pairs, progress):
        if pair.made.frames < MIN_FRAMES:
            raise MotionError(f"clip {pair.name} has {pair.made.frames} frames, scores need {MIN_FRAMES}; leave it out")
        made.append(measure_clip(pair.made, extractor))
        true.append(measure_clip(pair.true, extractor))
    latents = [[clip.latents for clip in side if clip.latents] for side in (made, true)]
    rows = [fid_row(*latents, seed=seed)] if extractor else []
    if all(pair.audio is not None for pair in pairs):
        heard = [ClipAudio(pair.audio, pair.domain) for pair in pairs if pair.audio is not None]
        places, truths = [clip.positions for clip in made], [clip.positions for clip in true]
        rows += gesture_rows(heard, places, truths, seed=seed) + dance_rows(heard, places, truths, seed=seed)
    rows += feature_rows(pairs, made, true, seed=seed)
    rows += clip_rows(made, true, seed=seed) + liveliness_rows(pairs, seed=seed)
    return rows + error_rows([_errors(pair) for pair in pairs], [pair.made.frames for pair in pairs], seed=seed)


def feature_rows(
    pairs: Sequence[Pair], made: Sequence[ClipMeasurements], true: Sequence[ClipMeasurements], *, seed: int = 0
) -> list[Row]:
    """FID_k and FID_g of the music, in stretches of up to 20 s; none with under two clips that have 10 s of it."""
    dances = [stretches(pair.domain, MUSIC) for pair in pairs]
    if sum(map(bool, dances)) < 2:
        return []

    def features(clips: Sequence[ClipMeasurements], name: Callable[..., Features]) -> list[Features]:
        found = []
        for clip, parts in zip(clips, dances, strict=True):
            cuts = [cut for part in parts for cut in windows(clip.positions[part], FRAME_RATE_HZ, LONGEST_S)]
            if cuts:
                found.append(np.stack([name(smpl_positions(at_rate(cut, RATE_HZ))) for cut in cuts]))
        return found

    rows = []
    for row, name in (("fid_k", kinetic), ("fid_g", geometric)):
        ours, theirs = features(made, name), features(true, name)
        every = np.concatenate(theirs)
        scaled = [[moments(scaled_by_truth(clip, every)[0]) for clip in side] for side in (ours, theirs)]
        rows.append(fid_row(*scaled, seed=seed)._replace(name=row))
    return rows


def semantic_row(pairs: Sequence[Pair], folder: Path, *, seed: int = 0) -> Row:
    """SRGR with the labels of a folder, NAME.txt for each clip; `truth` is what a perfect clip scores.

    Raises:
        EchoAvatarError: labels are missing or damaged.
    """
    values, best, weights = [], [], []
    for pair in pairs:
        labels = read_labels(folder / f"{pair.name}.txt", pair.made.frames)
        sides = [motion.pose().positions.astype(np.float64) for motion in (pair.made, pair.true)]
        sides = [side - side[:, :1] for side in sides]
        values.append(srgr(sides[0], sides[1], labels))
        best.append(srgr(sides[1], sides[1], labels))
        weights.append(float(pair.made.frames))
    columns = {"truths": np.array(best), "weights": np.array(weights)}
    return row_of_means("srgr", "", np.array(values), **columns, seed=seed)


def style_rows(audio: Features, motion: Features, styles: Sequence[str], *, seed: int = 0) -> list[Row]:
    """MDSC's distances and ratio, with intervals over pairs; chance of the ratio is 1."""

    def at(which: int) -> Callable[[Int[np.ndarray, " n"]], float]:
        return lambda chosen: style_consistency(audio, motion[chosen], styles, [styles[k] for k in chosen])[which]

    every = np.arange(len(motion))
    return [
        Row(f"style_{name}", "", at(k)(every), interval(at(k), len(motion), samples=FID_SAMPLES, seed=seed))._replace(
            chance=1.0 if name == "ratio" else float("nan")
        )
        for k, name in enumerate(Consistency._fields)
    ]


def clip_rows(
    made: Sequence[ClipMeasurements], true: Sequence[ClipMeasurements] | None = None, *, seed: int = 0
) -> list[Row]:
    """The rows of `UNITS`: means over clips weighted by length, of the skate by the frames of planted feet."""

    def row(name: str, clips: Sequence[ClipMeasurements]) -> Row:
        weights = np.array([clip.planted if name == "skate" else len(clip.positions) for clip in clips], float)
        return row_of_means(name, UNITS[name], np.array([c.numbers[name] for c in clips]), weights=weights, seed=seed)

    rows = [row(name, made) for name in UNITS]
    return rows if true is None else [own._replace(truth=row(own.name, true).value) for own in rows]


def liveliness_rows(pairs: Sequence[Pair], *, seed: int = 0) -> list[Row]:
    """A row for each statistic of `metrics.liveliness`: means over windows of 30 s; shorter clips are one window."""
    made = np.array([clip_statistics(pair.made) for pair in pairs])
    true = np.array([clip_statistics(pair.true) for pair in pairs])
    weights = np.array([pair.made.frames for pair in pairs], float)
    return [
        row_of_means(name, unit, made[:, column], truths=true[:, column], weights=weights, seed=seed)
        for column, (name, unit) in enumerate(STATISTICS.items())
    ]


def fid_row(ours: Sequence[Moments], theirs: Sequence[Moments], *, seed: int = 0) -> Row:
    """FID with its interval over clips drawn jointly on both sides; `truth` compares two halves of the true clips."""

    def distance(clips: Sequence[int] | np.ndarray) -> float:
        return frechet_between(pooled([ours[k] for k in clips]), pooled([theirs[k] for k in clips]))

    ends = interval(distance, len(ours), is_centred=True, samples=FID_SAMPLES, seed=seed)
    ends = Interval(max(ends.low, 0.0), ends.high) if ends.low < 0 else ends  # centring can shift it below zero
    row = Row("fid", "", distance(range(len(ours))), ends)
    halves = pooled(theirs[::2]), pooled(theirs[1::2] or theirs[:1])
    if len(theirs) < 2 or min(half.rows for half in halves) < 2:
        return row
    return row._replace(truth=frechet_between(*halves))


def _errors(pair: Pair) -> Reconstruction:
    steps = [
        torch.from_numpy(np.diff(m.root[:, [0, 2]], axis=0, prepend=m.root[:1, [0, 2]])) for m in (pair.true, pair.made)
    ]
    return reconstruction(HUMANOID, *(torch.from_numpy(m.matrices()) for m in (pair.true, pair.made)), *steps)


# ---- a bundle


def evaluate(
    bundle: Bundle,
    clips: Sequence[Clip],
    recordings: Sequence[Sound] = (),
    *,
    extractor: Extractor | None = None,
    seed: int = 0,
    repeats: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[Row]:
    """All rows of a bundle: its codes, its use of the audio, all of `score`, behaviour by domain, timing, recordings.

    Every clip is performed `repeats` times with different seeds; values, and the ends of intervals, are means over the
    performances.
    """
    say = progress or (lambda what, done, total: None)
    rows = reconstruction_rows(bundle.tokenizer, clips, seed=seed)
    rows += reliance_rows(reliance(bundle.generator, token_clips(bundle, clips)))
    pipeline, count = Pipeline(bundle), len(clips)
    shown = animate_many(
        pipeline,
        [clip.audio for clip in clips] * repeats,
        seeds=[seed + SEED_STRIDE * again + number for again in range(repeats) for number in range(count)],
        progress=partial(say, "held-out clips"),
    )
    truths = [on_our_rig(clip.motion(bundle.skeleton)) for clip in clips]
    truth = [track(motion, clip.domain) for motion, clip in zip(truths, clips, strict=True)]
    tables = []
    for again in range(repeats):
        performed = [on_our_rig(one.motion) for one in shown[again * count : (again + 1) * count]]
        made = [track(motion, clip.domain) for motion, clip in zip(performed, clips, strict=True)]
        pairs = [
            Pair(clip.name, motion, true, clip.audio, clip.domain)
            for clip, motion, true in zip(clips, performed, truths, strict=True)
        ]
        table = score(pairs, extractor, seed=seed, progress=partial(say, "measuring"))
        tables.append(table + behaviour_rows(made, truth, bundle.chunk) + event_rows(clips, made, truth, seed=seed))
    return rows + mean_rows(tables) + recording_rows(pipeline, recordings, seed=seed, say=say)


def behaviour_rows(made: Sequence[Track], truth: Sequence[Track] | None, chunk: ChunkSize) -> list[Row]:
    """Energy by domain, stillness in silence, fastest joint and chunk borders, with the truth's own values."""
    values = _behaviour(made, chunk)
    truths = _behaviour(truth, chunk) if truth else {}
    return [Row(*key, value, truth=truths.get(key, float("nan"))) for key, value in values.items()]


def _behaviour(clips: Sequence[Track], chunk: ChunkSize) -> dict[tuple[str, str], float]:
    """Values by name and unit."""
    legs = [0, *(i for i, name in enumerate(HUMANOID.names) if name.endswith(("LowerLeg", "Foot", "Toes")))]
    energy = [leg_energy(clip, legs) for clip in clips]
    speed = [hand_speed_m_s(clip, HUMANOID.indices(("leftHand", "rightHand"))) for clip in clips]
    in_speech = by_domain(speed, clips, SPEECH)
    return {
        ("leg_energy_music_over_speech", ""): by_domain(energy, clips, MUSIC) / by_domain(energy, clips, SPEECH),
        ("silence_hand_speed_ratio", ""): by_domain(speed, clips, SILENCE) / in_speech,
        ("hand_speed_speech", "m/s"): in_speech,
        ("hand_speed_music", "m/s"): by_domain(speed, clips, MUSIC),
        ("max_joint_speed", "deg/s"): float(max(clip.angular_speed.max() for clip in clips)),
        ("border_speed_ratio", ""): border_speed_ratio(clips, chunk),
        ("border_ratio", ""): border_ratio(clips, chunk),
    }


def recording_rows(
    pipeline: Pipeline,
    recordings: Sequence[Sound],
    *,
    seed: int = 0,
    say: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> list[Row]:
    """Real speech and music: does the body dance to music only, and on the beats that librosa finds?"""
    if not recordings:
        return []
    takes = perform(pipeline, recordings, seed=seed, progress=partial(say, "recordings"))
    motions = [on_our_rig(take.motion) for take in takes]
    domains = [DOMAINS.index(recording.kind) for recording in recordings]
    tracks = [track(m, np.full(m.frames, one, np.uint8)) for m, one in zip(motions, domains, strict=True)]
    rows = clip_rows([measure_clip(motion) for motion in motions], seed=seed)
    rows += behaviour_rows(tracks, None, pipeline.chunk)
    arms = HUMANOID.indices(ARM_JOINTS)
    for kind, name in ((SPEECH, "ba_onset"), (MUSIC, "ba_beat")):
        chosen = zip(recordings, tracks, strict=True)
        picked = [(one.audio, own.positions) for one, own in chosen if one.kind == DOMAINS[kind]]
        detect = speech_onsets if kind == SPEECH else music_beats
        events = [detect(audio, SAMPLE_RATE_HZ) for audio, _ in picked]
        found = [gesture_beats(p[:, arms]) if kind == SPEECH else [dance_beats(p)] for _, p in picked]
        rows.append(alignment_row(name, events, found, seed=seed))
    return [row._replace(name=f"recordings_{row.name}") for row in rows]


# ---- retrieval


def read_embeddings(path: Path) -> tuple[Features, Features, list[str] | None]:
    """Arrays `audio` and `motion` of an `.npz`, one pair a row, and the pairs' `style`, if there is one.

    Raises EchoAvatarError: missing, damaged, of different shapes, or not finite.
    """
    try:
        with NpzArrays(path) as stored:
            audio, motion = stored["audio"], stored["motion"]
            styles = [str(style) for style in stored["style"]] if "style" in stored else None
    except FileNotFoundError as error:
        raise EchoAvatarError(f"{path} does not exist; check the name") from error
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise EchoAvatarError(f"{path} holds no arrays `audio` and `motion`; write them with np.savez") from error
    if audio.shape != motion.shape or audio.ndim != 2 or len(audio) < 2:
        raise EchoAvatarError(
            f"{path}: audio {audio.shape} and motion {motion.shape} must both be (pairs, size), two pairs or more"
        )
    if not (np.isfinite(audio).all() and np.isfinite(motion).all()):
        raise EchoAvatarError(f"{path} holds values that are not finite; make the embeddings again")
    if styles is not None and len(styles) != len(audio):
        raise EchoAvatarError(f"{path}: style has {len(styles)} names for {len(audio)} pairs; give one a pair")
    return audio, motion, styles


def retrieval_rows(audio: Float[np.ndarray, "n d"], motion: Float[np.ndarray, "n d"], *, seed: int = 0) -> list[Row]:
    """Retrieval of motion by audio and back, among all pairs and in one gallery of 300, with chance and intervals.

    R@K and MRR in percent, MedR in ranks; `a2m` queries motion with audio. Intervals are over queries.
    """
    every = similarity(audio, motion)
    rows = _gallery_rows(every, "all", seed)
    if len(every) > PAPER_GALLERY:
        chosen = np.random.default_rng(seed).permutation(len(every))[:PAPER_GALLERY]
        rows += _gallery_rows(every[np.ix_(chosen, chosen)], str(PAPER_GALLERY), seed)
    return rows


def _gallery_rows(matrix: Float[np.ndarray, "n n"], gallery: str, seed: int) -> list[Row]:
    rows, guess = [], chance(len(matrix), SHOWN_KS)

    def percent(name: str, values: Float[np.ndarray, " n"], level: float) -> Row:
        return row_of_means(name, "%", values, chances=np.full(len(values), level), seed=seed)

    for way, similarities in (("a2m", matrix), ("m2a", matrix.T)):
        rank = ranks(similarities)
        for k in SHOWN_KS:
            rows.append(percent(f"{way}_r{k}_{gallery}", (rank < k) * 100.0, guess.recall[k]))
        middle = _median_rank(rank, np.arange(len(rank)))
        ends = interval(partial(_median_rank, rank), len(rank), seed=seed)
        rows.append(Row(f"{way}_medr_{gallery}", "rank", middle, ends, guess.median_rank, middle - guess.median_rank))
        rows.append(percent(f"{way}_mrr_{gallery}", 100 / (rank + 1), guess.reciprocal_rank))
    return rows


def _median_rank(rank: Float[np.ndarray, " n"], queries: Int[np.ndarray, " k"]) -> float:
    return float(np.median(rank[queries])) + 1
