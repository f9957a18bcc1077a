"""`echoavatar evaluate`: all scores of a bundle on held-out audio and motion.

Held-out rehearsal clips have true motion to compare with; recordings (without) show whether the behaviour carries over.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from echoavatar.engine import animate_many
from echoavatar.engine.pipeline import Bundle, Pipeline
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.kinematics.contact import planted, skate
from echoavatar.motion.kinematics.features import from_features, travel_slice
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar_lab.data import Clip
from echoavatar_lab.models.tokenize import clip_features

from . import beats, behaviour
from .behaviour import MUSIC, SILENCE, SPEECH, Track
from .metrics.audio_events import music_beats, speech_onsets
from .metrics.dance_alignment import dance_beats
from .metrics.gesture_alignment import ARM_JOINTS, STROKE_DELAY_S, gesture_beats
from .metrics.physical import jerk_m_s3
from .reconstruction import codebook_use, reconstruction
from .reliance import reliance, token_clips

Progress = Callable[[str, int, int], None]
SEED_STRIDE = 100  # difference between the seeds of two performances


@dataclass(frozen=True)
class Recording:
    """A real recording: its domain, and its audio at 24 kHz."""

    name: str
    kind: int  # SPEECH or MUSIC
    audio: np.ndarray


def evaluate(
    bundle: Bundle,
    clips: Sequence[Clip],
    recordings: Sequence[Recording] = (),
    *,
    seed: int = 0,
    repeats: int = 1,
    progress: Progress | None = None,
) -> dict[str, float]:
    """All scores of a bundle by name, with chance levels and the truth's values; names carry the units.

    Every clip is performed `repeats` times with different seeds, and the motion scores cover all performances.
    """
    say = progress or (lambda what, done, total: None)
    scores = reconstruction_scores(bundle.tokenizer, clips)
    scores |= reliance(bundle.generator, token_clips(bundle, clips))
    pipeline = Pipeline(bundle)
    seeds = [seed + SEED_STRIDE * again + number for again in range(repeats) for number in range(len(clips))]
    clips = [*clips] * repeats
    shown = animate_many(pipeline, [clip.audio for clip in clips], seeds=seeds, progress=partial(say, "held-out clips"))
    made = [
        behaviour.track(bundle.skeleton, motion.rotations, motion.root, clip.domain)
        for (motion, *_), clip in zip(shown, clips, strict=True)
    ]
    truth = [behaviour.track(bundle.skeleton, clip.rotations, clip.root, clip.domain) for clip in clips]
    scores |= behaviour_scores(bundle, made, truth)
    scores |= beat_scores(bundle.skeleton, clips, {"": made, "_truth": truth})
    scores |= recording_scores(pipeline, bundle, recordings, seed=seed, say=say)
    return scores


def reconstruction_scores(tokenizer: BodyTokenizer, clips: Sequence[Clip]) -> dict[str, float]:
    """Reconstruction errors weighted by length, and the use of the least used layer-0 codebook."""
    skeleton, travel = tokenizer.skeleton, travel_slice(tokenizer.skeleton)
    rows, codes = [], []
    for clip in clips:
        features = clip_features(tokenizer, clip)
        with torch.inference_mode():
            coded = tokenizer.encode(features[None])
            rebuilt = tokenizer.decode(coded)[0]
        codes.append(coded[0])
        rows.append(
            reconstruction(
                skeleton,
                from_features(skeleton, features).rotations,
                from_features(skeleton, rebuilt).rotations,
                features[:, travel][:, :2],
                rebuilt[:, travel][:, :2],
            )
        )
    mean = np.average(np.array(rows), axis=0, weights=[clip.frames for clip in clips])
    use = codebook_use(torch.cat(codes), tokenizer.config.codes)[:, 0]
    names = ("mpjpe_body_mm", "mpjpe_hands_mm", "root_velocity_mm")
    return dict(zip(names, map(float, mean), strict=True)) | {"codebook_use_min": float(use.min())}


def behaviour_scores(bundle: Bundle, made: Sequence[Track], truth: Sequence[Track]) -> dict[str, float]:
    """Energy by domain, stillness, feet, smoothness; the truth's own values as `..._truth`."""
    scores: dict[str, float] = {}
    for suffix, clips in (("", made), ("_truth", truth)):
        scores |= {key + suffix: value for key, value in _behaviour(bundle, clips).items()}
    scores["jerk_ratio"] = scores["jerk_m_s3"] / scores["jerk_m_s3_truth"]
    return scores


def _behaviour(bundle: Bundle, clips: Sequence[Track]) -> dict[str, float]:
    names = bundle.skeleton.names
    legs = [0, *(i for i, name in enumerate(names) if name.endswith(("LowerLeg", "Foot", "Toes")))]
    hands = [names.index("leftHand"), names.index("rightHand")]
    energy = [behaviour.leg_energy(clip, legs) for clip in clips]
    speed = [behaviour.hand_speed_m_s(clip, hands) for clip in clips]
    balls = list(bundle.skeleton.config.feet)[1::2]  # the ankle may swing over a planted ball; the ball must not move
    standing = bundle.skeleton.rest_positions[balls, 1].numpy()
    sliding, weight = [], []
    for clip in clips:
        positions = clip.positions[:, balls]
        sliding.append(skate(positions, FRAME_RATE_HZ, standing_height=standing))
        weight.append(float(planted(positions, FRAME_RATE_HZ, standing_height=standing).sum()) + 1e-6)
    return {
        "leg_energy_music_over_speech": behaviour.by_domain(energy, clips, MUSIC)
        / behaviour.by_domain(energy, clips, SPEECH),
        "silence_hand_speed_ratio": behaviour.by_domain(speed, clips, SILENCE)
        / behaviour.by_domain(speed, clips, SPEECH),
        "hand_speed_speech_m_s": behaviour.by_domain(speed, clips, SPEECH),
        "hand_speed_music_m_s": behaviour.by_domain(speed, clips, MUSIC),
        "skate_cm_s": float(np.average(sliding, weights=weight)),
        "jerk_m_s3": float(np.mean([jerk_m_s3(clip.positions) for clip in clips])),
        "max_joint_deg_s": float(max(clip.angular_speed.max() for clip in clips)),
        "border_speed_ratio": behaviour.border_speed_ratio(clips, bundle.chunk),
        "border_ratio": behaviour.border_ratio(clips, bundle.chunk),
    }


def beat_scores(skeleton: Skeleton, clips: Sequence[Clip], motions: Mapping[str, Sequence[Track]]) -> dict[str, float]:
    """BA on stressed syllables and on music beats, with chance levels; names end in the keys of `motions`."""
    arms = skeleton.indices(ARM_JOINTS)
    onsets = [clip.events.get("stress", np.zeros(0)) + STROKE_DELAY_S for clip in clips]
    events = {"onset": onsets}
    events["beat"] = [clip.events.get("beats", np.zeros(0)) for clip in clips]
    scores: dict[str, float] = {}
    for suffix, tracks in motions.items():
        found = {
            "onset": [gesture_beats(track.positions[:, arms]) for track in tracks],
            "beat": [[dance_beats(track.positions)] for track in tracks],
        }
        for kind, times in events.items():
            own, chance = beats.alignment_and_chance(times, found[kind])
            scores[f"ba_{kind}{suffix}"], scores[f"ba_{kind}_chance{suffix}"] = own, chance
        scores |= {key + suffix: value for key, value in _timing(clips, tracks, arms).items()}
    return scores


def _timing(clips: Sequence[Clip], tracks: Sequence[Track], arms: Sequence[int]) -> dict[str, float]:
    """Speed of the arms on stressed syllables over that after them; speed of the body on beats over its mean."""

    def around(event: str, joints: slice | list[int], seconds: tuple[float, float]) -> float:
        shares = [
            beats.speed_around(
                (track.positions - track.positions[:, :1])[:, joints], clip.events.get(event, np.zeros(0)), seconds
            )
            for clip, track in zip(clips, tracks, strict=True)
        ]
        joined = np.concatenate(shares)
        return float(joined.mean()) if len(joined) else float("nan")

    stroke, after = (around("stress", list(arms), span) for span in ((-0.1, 0.07), (0.17, 0.43)))
    return {"stroke_contrast": stroke / after, "beat_dip": around("beats", slice(None), (0.0, 0.04))}


def recording_scores(
    pipeline: Pipeline, bundle: Bundle, recordings: Sequence[Recording], *, seed: int, say: Progress
) -> dict[str, float]:
    """Scores on real speech and music: does the body dance to music only, and on the beats that librosa finds?"""
    if not recordings:
        return {}
    arms = bundle.skeleton.indices(ARM_JOINTS)
    shown = animate_many(
        pipeline,
        [recording.audio for recording in recordings],
        seeds=range(seed, seed + len(recordings)),
        progress=partial(say, "recordings"),
    )
    tracks, events = [], []
    for (motion, *_), recording in zip(shown, recordings, strict=True):
        domain = np.full(motion.frames, recording.kind, np.uint8)
        tracks.append(behaviour.track(bundle.skeleton, motion.rotations, motion.root, domain))
        detect = speech_onsets if recording.kind == SPEECH else music_beats
        events.append(detect(recording.audio, SAMPLE_RATE_HZ))
    scores = {f"recordings_{key}": value for key, value in _behaviour(bundle, tracks).items()}
    for kind, name in ((SPEECH, "onset"), (MUSIC, "beat")):
        picked = [i for i, recording in enumerate(recordings) if recording.kind == kind]
        places = [tracks[i].positions for i in picked]
        found = [gesture_beats(p[:, arms]) if kind == SPEECH else [dance_beats(p)] for p in places]
        own, chance = beats.alignment_and_chance([events[i] for i in picked], found)
        scores[f"recordings_ba_{name}"], scores[f"recordings_ba_{name}_chance"] = own, chance
    return scores
