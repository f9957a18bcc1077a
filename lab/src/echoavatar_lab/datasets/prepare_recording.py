"""All steps of one recording: read, check, resample, retarget, trim, replace bad fingers, label, write its part.

A part is a clip in `parts/NAME.npz` and its receipt in `parts/NAME.json`. The receipt is written last, so it marks a
finished part. The result depends only on the files, the options and the name.

Labels are measured from sound: silence, speech or music per frame, beats and stressed syllables. Hands that are not
worth learning from get new fingers (paper, Motion Refinement): the paper finds that much of Motorica has static or
erratic fingers. Static fingers hardly turn. Erratic fingers tremble (from frame to frame, the angular velocity changes
by about its own size) or bend further than fingers can. Each hand is judged over the whole clip, at 30 frames per
second.
"""

import time
import zlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import AudioError, EchoAvatarError, MotionError
from echoavatar.json_reader import read_object_file
from echoavatar.models.audio import read_audio
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import Motion, SkeletonConfig
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import angle_between, axis_angle_from_quaternion, quaternion_from_matrix
from echoavatar.timing import CHUNK_FRAMES, FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import write_whole
from echoavatar_lab.corpora.rehearsal.corpus import domains
from echoavatar_lab.corpora.rehearsal.recording_labels import track_from_recording
from echoavatar_lab.data import Clip
from echoavatar_lab.data.corpus import checksum, count_domains
from echoavatar_lab.data.statistics import describe
from echoavatar_lab.foreign.smpl import read_smplx
from echoavatar_lab.models.fingers.clips import FROZEN_DEG_S
from echoavatar_lab.models.fingers.model import load_shipped
from echoavatar_lab.models.fingers.refine import finger_joints, refine_fingers

from .lda import SUFFIX, read_lda
from .retargeted import annotate_rig, fidelity, keep_hand_contact
from .source import Domain, Recording, SetOptions


def sound_labels(audio: NDArray[np.float32], kind: Domain) -> tuple[NDArray[np.uint8], dict[str, tuple[float, ...]]]:
    """Domain (t,) of each frame, and times in seconds of beats, downbeats and stresses, as in a rehearsal clip.

    Sound that is shorter than two seconds or nearly silent is labelled as silence.
    """
    frames = len(audio) // SAMPLES_PER_FRAME
    if len(audio) < 2 * SAMPLE_RATE_HZ or float(np.abs(audio).max()) < 1e-4:
        return np.zeros(frames, np.uint8), {}
    track = track_from_recording(audio, kind)
    events: dict[str, Sequence[float]] = {
        "beats": track.beats.tolist(),
        "downbeats": track.downbeats.tolist(),
        "stress": track.stresses,
    }
    end = len(audio) / SAMPLE_RATE_HZ
    kept = {name: tuple(round(time, 4) for time in times if 0 <= time < end) for name, times in events.items()}
    return domains(track, frames), {name: times for name, times in kept.items() if times}


State = Literal["good", "static", "erratic", "none"]
SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")
TREMBLE = 0.6  # between recorded hands (up to 0.4) and white noise (0.77 and more)
TREMBLE_DEG_S = 20.0  # slower trembling is not visible
MOST_BENT_DEG = 140.0  # more than recorded fingers ever bend


class HandScores(NamedTuple):
    """How the fingers of one hand move."""

    speed_deg_s: float  # mean over bones and frames
    tremble: float  # relative change of angular velocity between frames: 0 steady, about 0.87 white noise
    bend_deg: float  # 99th percentile of the angle from rest

    @property
    def state(self) -> State:
        """The state that these scores mean."""
        if self.speed_deg_s < FROZEN_DEG_S:
            return "static"
        trembles = self.tremble > TREMBLE and self.speed_deg_s > TREMBLE_DEG_S
        return "erratic" if trembles or self.bend_deg > MOST_BENT_DEG else "good"


def hand_states(motion: Motion) -> dict[str, State]:
    """State of the left and right hand; "none" if the rig has no finger bones."""
    rotations = motion.matrices()
    states: dict[str, State] = {}
    for side in SIDES:
        joints = list(finger_joints(motion, side).values())
        states[side] = hand_scores(rotations[:, joints], motion.fps).state if joints else "none"
    return states


def hand_scores(rotations: Float[np.ndarray, "t j 3 3"], fps: float) -> HandScores:
    """Score the rotations (t, j, 3, 3) of the finger bones of one hand, each relative to its parent."""
    bend = np.degrees(angle_between(rotations, np.eye(3, dtype=rotations.dtype)))
    step = axis_angle_from_quaternion(quaternion_from_matrix(rotations[:-1].mT @ rotations[1:]))
    speed, change = np.linalg.norm(step, axis=-1), np.linalg.norm(np.diff(step, axis=0), axis=-1)
    both = (speed[1:] + speed[:-1]).sum() if len(speed) > 1 else 0.0
    return HandScores(
        speed_deg_s=float(np.degrees(speed).mean() * fps) if len(speed) else 0.0,
        tremble=float(change.sum() / both) if both > 0 else 0.0,
        bend_deg=float(np.percentile(bend, 99)),
    )


def mend_hands(motion: Motion, states: dict[str, State], seed: int, *, is_all: bool) -> tuple[Motion, list[str]]:
    """Give new fingers to static and erratic hands, or to all; return the motion and the sides that changed."""
    sides = [side for side in SIDES if states[side] != "none" and (is_all or states[side] != "good")]
    if not sides:
        return motion, []
    hands = "both" if len(sides) == 2 else sides[0]
    return refine_fingers(_finger_model(), motion, hands=hands, seed=seed), list(sides)


_finger_model = cache(load_shipped)


SLOWEST_FPS = 15.0  # captured motion has at least this frame rate
RATES = (24.0, 25.0, 30.0, 50.0, 60.0, 90.0, 100.0, 120.0, 240.0)  # candidates if the header's rate is wrong
NOTED_CUT_S = 0.1  # shorter cuts are not noted
Sound = np.ndarray


class Receipt(Config):
    """The description of the clip that was made of one recording; stored in `recordings.json`."""

    name: str = Field(description="of the clip")
    split: str = Field(description="train, val or test")
    frames: int = Field(gt=0, description="length at 30 frames per second")
    domains: dict[str, int] = Field(description="frames of silence, speech and music")
    has_sound: bool = Field(description="False: motion alone")
    labels: dict[str, str] = Field(default_factory=dict, description="speaker, style, genre")
    events: dict[str, tuple[float, ...]] = Field(default_factory=dict, description="times by kind")
    skeleton: SkeletonConfig | None = Field(default=None, description="the rig of the clip; None: the humanoid")
    sources: dict[str, str] = Field(description="source files and their checksums")
    stamp: str = Field(
        description="size and time of the files, and the options: unchanged means the part is still valid"
    )
    source_fps: float = Field(description="frame rate of the recording")
    hands: dict[str, str] = Field(description="state of the fingers as recorded: good, static, erratic, none")
    mended: tuple[str, ...] = Field(default=(), description="sides with new fingers")
    notes: tuple[str, ...] = Field(default=(), description="remarks for the user")
    fidelity: dict[str, float] = Field(default_factory=dict, description="how close to the source (`fidelity`)")
    motion: dict[str, float] = Field(description="statistics of the motion (`kinematics.statistics`)")
    work_seconds: float = Field(description="processing time")


def prepare_recording(recording: Recording, options: SetOptions, folder: Path) -> Receipt:
    """Make the part of one recording that has a split.

    Raises EchoAvatarError if a file is missing, damaged or does not fit; the message names the file and the remedy.
    """
    started = time.perf_counter()
    file = sound_file(recording, options)
    sound = None if file is None else np.asarray(read_audio(file), np.float32)
    recorded = _motion(recording, options)
    notes = _rate_notes(recording, recorded)
    source = resample(recorded, float(FRAME_RATE_HZ))
    frames, cuts = _common_length(recording, recorded, source.frames, sound, options.length_tolerance)
    notes += cuts
    source = source.cut(0, frames)
    result = annotate_rig(source) if options.rig == "native" else keep_hand_contact(retarget(source), source)
    states = hand_states(result)
    mended: list[str] = []
    if options.fingers != "keep":
        seed = int(np.random.SeedSequence([options.seed, zlib.crc32(recording.name.encode())]).generate_state(1)[0])
        result, mended = mend_hands(result, states, seed % 2**31, is_all=options.fingers == "all")
    audio = np.zeros(frames * SAMPLES_PER_FRAME, np.float32)
    if sound is not None:
        audio = sound[: frames * SAMPLES_PER_FRAME]
        notes += ["its sound is silence"] if float(np.abs(audio).max()) < 1e-4 else []
    domain, events = sound_labels(audio, recording.domain)
    clip = Clip(
        recording.name,
        audio,
        result.rotations,
        result.root,
        domain,
        events={kind: np.array(times) for kind, times in events.items()},
        split=recording.split,
    )
    clip.save(part_path(folder, recording.name))
    receipt = Receipt(
        name=recording.name,
        split=recording.split,
        frames=frames,
        domains=count_domains(domain),
        has_sound=sound is not None,
        labels=dict(recording.labels),
        events=events,
        skeleton=result.skeleton.config if options.rig == "native" else None,
        sources={path.name: checksum(path) for path in _files(recording, options)},
        stamp=stamp(recording, options),
        source_fps=recorded.fps,
        hands=dict(states),
        mended=tuple(mended),
        notes=tuple(notes),
        fidelity=fidelity(source, result) if options.rig == "unified" else {},
        motion={key: round(value, 5) for key, value in describe(result).items()},
        work_seconds=round(time.perf_counter() - started, 2),
    )
    write_whole(part_path(folder, recording.name).with_suffix(".json"), receipt.model_dump_json())
    return receipt


def part_path(folder: Path, name: str) -> Path:
    """Path of a recording's clip until it is written to a shard."""
    return folder / "parts" / f"{name}.npz"


def finished_part(folder: Path, name: str) -> Receipt | None:
    """The receipt of a finished part, or None if a file of it is missing or damaged."""
    path = part_path(folder, name).with_suffix(".json")
    try:
        receipt = Receipt.model_validate(read_object_file(path))
    except (OSError, EchoAvatarError, ValidationError):
        return None
    return receipt if part_path(folder, name).is_file() else None


def stamp(recording: Recording, options: SetOptions) -> str:
    """A mark that changes with the options and with size or modification time of a recording's files."""
    files = [
        f"{path.stat().st_size}:{path.stat().st_mtime_ns}" for path in _files(recording, options) if path.is_file()
    ]
    return " ".join([*files, options.digest()])


def _files(recording: Recording, options: SetOptions) -> list[Path]:
    sound = recording.sound if options.sound != "none" else None
    return [recording.motion, *([sound] if sound is not None and sound.is_file() else [])]


def sound_file(recording: Recording, options: SetOptions) -> Path | None:
    """The sound that the set takes of a recording; None: the motion alone. Raises AudioError if it must be there."""
    sound = recording.sound
    if sound is None or options.sound == "none" or (options.sound == "any" and not sound.is_file()):
        return None
    if not sound.is_file():
        raise AudioError(f"{sound} is missing; add it, or pass --sound any to take the motion alone")
    return sound


def _motion(recording: Recording, options: SetOptions) -> Motion:
    if recording.motion.suffix.lower() == ".npz":
        motion = read_smplx(recording.motion, body_model=options.body_model)
    elif recording.motion.name.endswith(SUFFIX):
        motion = read_lda(
            recording.motion, read_bvh(recording.rig, metres_per_unit=0.01).skeleton if recording.rig else None
        )
    else:
        motion = read_bvh(recording.motion, options.joints)
    if motion.fps < SLOWEST_FPS:
        raise MotionError(
            f"{recording.motion} has {motion.fps:g} frames per second, less than any captured motion; correct its"
            " 'Frame Time' (seconds per frame)"
        )
    return motion


def _rate_notes(recording: Recording, motion: Motion) -> list[str]:
    if not recording.rates or any(abs(motion.fps - rate) < 0.01 * rate for rate in recording.rates):
        return []
    published = " or ".join(f"{rate:g}" for rate in recording.rates)
    return [f"{motion.fps:g} frames per second, published at {published}"]


def _common_length(
    recording: Recording, recorded: Motion, frames: int, sound: Sound | None, tolerance: float
) -> tuple[int, list[str]]:
    """Frames that motion and sound share, and notes on what was cut; refuses lengths that differ too much."""
    notes = []
    if sound is not None:
        moves, sounds = recorded.seconds, len(sound) / SAMPLE_RATE_HZ
        if abs(moves - sounds) > tolerance * max(moves, sounds):
            rate = recorded.frames / max(sounds, 1e-3)
            likely = [known for known in RATES if abs(rate - known) < 0.02 * known]
            why = (
                f"it would fit at {likely[0]:g}: correct its frame rate"
                if likely
                else "they do not belong together or one is incomplete: fetch both again"
            )
            raise MotionError(
                f"{recording.motion.name} lasts {moves:.1f} s at {recorded.fps:g} frames per second, its sound"
                f" {sounds:.1f} s; {why}"
            )
        heard = len(sound) // SAMPLES_PER_FRAME
        if abs(gone := moves - sounds) > NOTED_CUT_S:
            notes.append(f"{abs(gone):.2f} s of {'motion' if gone > 0 else 'sound'} cut from the end")
        frames = min(frames, heard)
    if frames < CHUNK_FRAMES:
        raise MotionError(
            f"{recording.motion.name} has {frames} frames at 30 per second; at least {CHUNK_FRAMES} are needed"
        )
    return frames, notes
