"""What codes carry: what the tokenizer keeps of the truth's timing, and what the generator makes of the audio.

Reliance: does the generator use the audio? NLL per code with the true audio and other audio (paper, conditional
collapse). A model that has collapsed onto its own history loses nothing with another clip's audio. The gain is what the
audio is worth to the model in nats per code, much of it for telling speech from music. What a clip's own audio is worth
over the same audio a few chunks late is the value of timing (`timing_gain`).

True codes (`echoavatar evaluate BUNDLE codes`): what is lost of the truth's timing and size between its motion and what
is shown. The true motion of held-out clips is encoded and decoded, and then sent through the stages behind the decoder.
No generator can be better in time than this. Then the generator draws each chunk after the true past: what is lost here
is lost in a single chunk, however well a performance keeps its phase. Last the bundle performs the clip's sound, with
its own past. In speech the same stages show where hands lose how people share the work between them
(`metrics.tells.SHARING`). Not in the paper, which reports errors of reconstruction alone.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from echoavatar.engine.manner import TALKER
from echoavatar.engine.pipeline import Bundle, Pipeline
from echoavatar.engine.settling import Settling
from echoavatar.motion.kinematics import HUMANOID, Motion, to_features
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.motion.stages.post import Post
from echoavatar.motion.stages.stillness import WHOLE
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, CHUNK, FRAME_RATE_HZ, FRAMES_PER_MOTION_TOKEN, ChunkSize
from echoavatar_lab.data import MUSIC, SPEECH, Clip
from echoavatar_lab.kinematics import from_features
from echoavatar_lab.models.fingers.clips import on_our_rig
from echoavatar_lab.models.generator.losses import nll_by_domain
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenize import audio_codes, motion_codes, motion_of_codes
from echoavatar_lab.models.tokenizer.measure import code_usage
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import whole_features
from echoavatar_lab.progress import Progress, watched

from .batch import animate_many
from .beat_rows import event_rows
from .measures import WINDOW_S, Track, stretches, track
from .metrics.liveliness import POINTS, shoulder_turn_deg, windows
from .metrics.positions import Reconstruction, jerk_m_s3, reconstruction
from .metrics.tells import JUDGED, SHARING, tells
from .table import Row, row_of_means, weighted_mean

HEARD = ("silence", "speech", "music", "all")
TRUTH, DECODED, SHOWN, DRAWN, PERFORMED = "truth", "decoded", "shown", "drawn", "performed"
SHORTEST_DANCE_S = 14
LATE_CHUNKS = 3  # 0.8 s: other syllables and beats, but the same voice and piece


def token_clips(bundle: Bundle, clips: Sequence[Clip]) -> list[TokenClip]:
    """The clips as codes of the bundle's codec and tokenizer, with the patience of the generator's training data."""
    patience = bundle.generator.config.patience
    return [
        TokenClip(
            audio_codes(bundle.codec, clip.audio, is_leveled=bundle.runtime.level_control),
            motion_codes(bundle.tokenizer, clip, patience=patience),
            clip.domain[::FRAMES_PER_MOTION_TOKEN],
            clip.split,
        )
        for clip in clips
    ]


class Reliance(NamedTuple):
    """NLL per code (nats) with the true audio, with another clip's, and with the same a few chunks late."""

    true: float
    shuffled: float
    late: float

    @property
    def gain(self) -> float:
        """How much the audio lowers the NLL."""
        return self.shuffled - self.true

    @property
    def timing_gain(self) -> float:
        """How much the audio's timing lowers the NLL."""
        return self.late - self.true


def reliance(generator: Generator, tokens: Sequence[TokenClip]) -> dict[str, Reliance]:
    """The reliance in each kind of sound in `HEARD` that occurs."""
    true = nll_by_domain(generator, tokens)
    shuffled = nll_by_domain(generator, tokens, shuffled_audio=True)
    late = nll_by_domain(
        generator,
        [replace(clip, audio=np.roll(clip.audio, LATE_CHUNKS * AUDIO_FRAMES_PER_CHUNK, axis=0)) for clip in tokens],
    )
    return {name: Reliance(true[name], shuffled[name], late[name]) for name in HEARD if name in true}


def reliance_rows(found: Mapping[str, Reliance]) -> list[Row]:
    """Rows `nll_X`, whose chance level is another clip's audio, and `timing_gain_X`."""
    rows = []
    for name, own in found.items():
        rows.append(Row(f"nll_{name}", "nats", own.true, chance=own.shuffled, excess=-own.gain))
        rows.append(Row(f"timing_gain_{name}", "nats", own.timing_gain))
    return rows


def reliance_table(generators: Mapping[str, Generator], tokens: Sequence[TokenClip]) -> str:
    """A Markdown table of generators side by side, by domain."""
    found = {name: reliance(generator, tokens) for name, generator in generators.items()}
    lines = ["| heard | " + " | ".join(f"{name}: true | shuffled | gain | timing" for name in found) + " |"]
    lines.append("|---|" + "---:|---:|---:|---:|" * len(found))
    for heard in HEARD:
        if all(heard in own for own in found.values()):
            columns = [own[heard] for own in found.values()]
            cells = [
                f"{one.true:.3f} | {one.shuffled:.3f} | {one.gain:+.3f} | {one.timing_gain:+.3f}" for one in columns
            ]
            lines.append(f"| {heard} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def reconstruction_rows(tokenizer: BodyTokenizer, clips: Sequence[Clip], *, seed: int = 0) -> list[Row]:
    """Reconstruction errors of the tokenizer, weighted by length, and the use of the least used layer-0 codebook."""
    skeleton, travel = tokenizer.skeleton, travel_slice(tokenizer.skeleton)
    errors, codes = [], []
    for clip in clips:
        features = whole_features(tokenizer.skeleton, clip)
        with torch.inference_mode():
            coded = tokenizer.encode(features[None])
            rebuilt = tokenizer.decode(coded)[0]
        codes.append(coded[0])
        motions = [from_features(skeleton, side).rotations for side in (features, rebuilt)]
        steps = [side[:, travel][:, :2] for side in (features, rebuilt)]
        errors.append(reconstruction(skeleton, *motions, *steps))
    rows = error_rows(errors, [clip.frames for clip in clips], prefix="codes_", seed=seed)
    use = min(float(code_usage(own, tokenizer.config.codes).fraction[0]) for own in torch.cat(codes).unbind(1))
    return [*rows, Row("codebook_use_min", "", use)]


def error_rows(errors: Sequence[Reconstruction], frames: Sequence[int], *, prefix: str = "", seed: int) -> list[Row]:
    """The rows of reconstruction errors of clips, means weighted by length."""
    weights = np.array(frames, float)
    named = zip(("mpjpe_body", "mpjpe_hands", "trans_loss"), ("mm", "mm", "mm/frame"), np.array(errors).T, strict=True)
    return [row_of_means(prefix + name, unit, values, weights=weights, seed=seed) for name, unit, values in named]


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
    codes that the generator draws for each chunk after the true past, decoded; `performed` is the bundle's motion to
    the clip's sound. Each has the statistics of `SHARING` in speech, too. With another `tokenizer` than the bundle's,
    whose codes the generator does not know, nothing is drawn or performed. `tokenizer` holds the errors of
    reconstruction.
    """
    others, tokenizer = tokenizer is not None, tokenizer or bundle.tokenizer
    post, pipeline = Post(tokenizer.skeleton), Pipeline(bundle.without(["face"]))
    tracks: dict[str, list[Track]] = {
        name: [] for name in (TRUTH, DECODED, SHOWN, *(() if others else (DRAWN, PERFORMED)))
    }
    for number, clip in enumerate(watched(clips, progress), 1):
        decoded = motion_of_codes(tokenizer, tokenizer.encode(whole_features(tokenizer.skeleton, clip)[None])[0])
        motions = {
            TRUTH: clip.motion(tokenizer.skeleton),
            DECODED: decoded,
            SHOWN: replayed(post, decoded, clip.audio if pipeline.has_manner else None, chunk=bundle.chunk),
        }
        if not others:
            [tokens] = token_clips(bundle, [clip])
            motions[DRAWN] = motion_of_codes(tokenizer, drawn_after_truth(bundle.generator, tokens, seed=seed + number))
            [made] = animate_many(pipeline, [clip.audio], seeds=[seed + number])
            motions[PERFORMED] = made.motion
        for name, motion in motions.items():
            tracks[name].append(track(on_our_rig(motion), clip.domain[: motion.frames]))
    found = {"tokenizer": {row.name: row.value for row in reconstruction_rows(tokenizer, clips)}}
    for name, own in tracks.items():
        rows = {row.name: row for row in event_rows(clips, own, tracks[TRUTH])}
        found[name] = {
            "onset_excess": rows["ba_onset"].excess,
            "beat_excess": rows["ba_beat"].excess,
            "jerk_m_s3": float(np.mean([jerk_m_s3(each.positions) for each in own])),
            "dance_turn_deg": dance_turn_deg(own),
        } | sharing_in_speech(own)
    return found


def sharing_in_speech(tracks: Sequence[Track]) -> dict[str, float]:
    """Means of `SHARING` over windows of up to 30 s of speech; NaN where no speech lasts 10 s."""
    at = HUMANOID.indices(JUDGED)
    rows = [
        tells(part, table=SHARING)
        for one in tracks
        for stretch in stretches(one.domain, SPEECH)
        for part in windows(one.positions[stretch][:, at].astype(np.float64), FRAME_RATE_HZ, WINDOW_S)
    ]
    return {name: weighted_mean(np.array([row[name] for row in rows])) for name in SHARING}


def replayed(
    post: Post,
    motion: Motion,
    audio: Float[np.ndarray, " s"] | None = None,
    *,
    options: MotionOptions = FREE,
    chunk: ChunkSize = CHUNK,
) -> Motion:
    """Run a finished motion through the stages, chunk by chunk, as a new session.

    With `audio` (24 kHz, as long as the motion) the body talks unless its legs dance, as in a session whose model has a
    manner; without, it never talks.
    """
    features = to_features(post.skeleton, motion.matrices(), motion.root)
    state, everyone, settling = post.init_state(1), np.ones(1, np.bool_), Settling(chunk)
    state.modes.choose(everyone, options)
    padded = np.pad(features, ((0, -len(features) % chunk.frames), (0, 0)), mode="edge")
    steps = list[MotionChunk]()
    for number, piece in enumerate(np.split(padded[None], len(padded) // chunk.frames, 1)):
        talks = audio is not None and not settling.is_dancing(number - 1)
        steps += post.step(piece, state, everyone, hands=(TALKER if talks else WHOLE)[None]).split(None)
        if audio is not None:
            block = audio[number * chunk.samples : (number + 1) * chunk.samples]
            settling.made(number, block, steps[-1], post.skeleton)
    shown = join(steps).part(0, motion.frames)
    place = motion.root[0] * np.array([1, 0, 1], np.float32)
    return replace(motion, rotations=shown.rotations, root=shown.root + place)


def dance_turn_deg(tracks: Sequence[Track]) -> float:
    """Mean deviation of the shoulders' turn against the hips over stretches of music of 14 s; NaN where none is."""
    at, turns = HUMANOID.indices(POINTS), []
    for one in tracks:
        is_music = np.pad(one.domain == MUSIC, 1)
        for start, end in np.flatnonzero(np.diff(is_music)).reshape(-1, 2):
            if end - start >= SHORTEST_DANCE_S * FRAME_RATE_HZ:
                turns.append(shoulder_turn_deg(one.positions[start:end, at]))
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
