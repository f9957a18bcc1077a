"""A clip: a stretch of sound and the motion that goes with it, on our clock (24 kHz, 30 frames per second).

Stored as one `.npz` without pickles: sound as 16-bit PCM (samples beyond +-1 are clipped), motion as float32.

Clips are mirrored across the plane x = 0 to augment training data. With M = diag(-1, 1, 1), the mirrored rotation of a
joint is M R M of the joint on the other side. The rest offsets of the rig must be symmetric too (`is_symmetric`).
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.motion.formats.tables import NPZ_ERRORS, NpzArrays
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import make_output_folder, whole_file

DOMAINS = ("silence", "speech", "music")
SILENCE, SPEECH, MUSIC = range(3)
SPLITS = ("train", "val", "test")
PCM = 32767.0
_EVENT = "event."
_LABEL = "label."


@dataclass(frozen=True)
class Clip:
    """Sound and motion of equal length. Arrays are not copied and must not be written to."""

    name: str  # file-safe name, unique in its corpus
    audio: NDArray[np.float32]  # (800 t,) float32 mono at 24 kHz
    rotations: NDArray[np.float32]  # (t, j, 4) float32 parent-relative unit quaternions `wxyz`, joints of `HUMANOID`
    root: NDArray[np.float32]  # (t, 3) float32 world position of the hips, metres
    domain: NDArray[np.uint8]  # (t,) uint8 per frame, an index into `DOMAINS`
    # Sorted times in seconds by kind: "beats", "downbeats", "stress".
    events: Mapping[str, NDArray[np.float64]] = field(default_factory=lambda: MappingProxyType({}))
    split: str = "train"  # "train", "val" or "test"
    labels: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))  # of the sound, such as speaker

    def __post_init__(self) -> None:
        """Raises MotionError for shapes that do not fit, values that are not finite, or an unknown split."""
        t = self.frames
        self._want(self.split in SPLITS, f"split is {self.split!r}, use one of {', '.join(SPLITS)}")
        self._want(t > 0, "it has no frames")
        self._want(
            self.rotations.ndim == 3 and self.rotations.shape[-1] == 4,
            f"rotations have shape {self.rotations.shape}, expected (frames, joints, 4)",
        )
        self._want(self.root.shape == (t, 3), f"root has shape {self.root.shape}, expected ({t}, 3)")
        self._want(self.domain.shape == (t,), f"domain has shape {self.domain.shape}, expected ({t},)")
        samples = t * SAMPLES_PER_FRAME
        self._want(
            self.audio.shape == (samples,),
            f"audio has shape {self.audio.shape}, expected ({samples},): {SAMPLES_PER_FRAME} samples a frame",
        )
        self._want(int(self.domain.max()) < len(DOMAINS), f"domain goes to {self.domain.max()}, highest is 2")
        for label, values in (("audio", self.audio), ("rotations", self.rotations), ("root", self.root)):
            self._want(bool(np.isfinite(values).all()), f"{label} is not finite everywhere; make it again")
        off = float(np.abs(np.linalg.norm(self.rotations, axis=-1) - 1).max())
        self._want(off < 1e-3, f"rotations are not unit quaternions (off by {off:.3g}); normalise them")

    def _want(self, is_met: bool, complaint: str) -> None:
        if not is_met:
            raise MotionError(f"clip {self.name!r}: {complaint}")

    @property
    def frames(self) -> int:
        """Number of motion frames."""
        return int(self.rotations.shape[0])

    @property
    def seconds(self) -> float:
        """Length in seconds."""
        return self.frames / FRAME_RATE_HZ

    def motion(self, skeleton: Skeleton = HUMANOID) -> Motion:
        """Its motion, on the rig of its corpus."""
        return Motion(skeleton, self.rotations, self.root, float(FRAME_RATE_HZ))

    def save(self, path: Path | str) -> None:
        """Write to `.npz`, completely or not at all."""
        path = Path(path)
        make_output_folder(path.parent, error=MotionError)
        arrays: dict[str, Any] = {
            "name": np.array(self.name),
            "split": np.array(self.split),
            "audio": np.round(np.clip(self.audio, -1, 1) * PCM).astype(np.int16),
            "rotations": self.rotations.astype(np.float32),
            "root": self.root.astype(np.float32),
            "domain": self.domain.astype(np.uint8),
            **{_EVENT + kind: np.asarray(times, np.float64) for kind, times in self.events.items()},
            **{_LABEL + kind: np.array(text) for kind, text in self.labels.items()},
        }
        with whole_file(path, error=MotionError) as partial, partial.open("wb") as file:
            np.savez(file, **arrays)

    @classmethod
    def load(cls, path: Path | str) -> "Clip":
        """Read a saved clip; raises MotionError if the file is missing, damaged or not a clip."""
        with open_clip(path) as stored:
            return cls(
                name=str(stored["name"]),
                audio=stored["audio"].astype(np.float32) / np.float32(PCM),
                rotations=stored["rotations"],
                root=stored["root"],
                domain=stored["domain"],
                events={key[len(_EVENT) :]: stored[key] for key in stored if key.startswith(_EVENT)},
                split=str(stored["split"]),
                labels=stored_labels(stored),
            )


def stored_labels(stored: NpzArrays) -> dict[str, str]:
    """The labels of an opened clip."""
    return {key[len(_LABEL) :]: str(stored[key]) for key in stored if key.startswith(_LABEL)}


@contextmanager
def open_clip(path: Path | str) -> Iterator[NpzArrays]:
    """Context in which the stored arrays of a clip are read on access; read errors become MotionError."""
    try:
        with NpzArrays(Path(path), MotionError) as stored:
            yield stored
    except FileNotFoundError as error:
        raise MotionError(f"clip {path} does not exist; make the corpus again") from error
    except KeyError as error:
        raise MotionError(f"clip {path} lacks {error.args[0]!r}; make the corpus again") from error
    except NPZ_ERRORS as error:
        raise MotionError(f"clip {path} is damaged or not a clip ({error}); make the corpus again") from error


def mirror_quaternions(skeleton: Skeleton, quaternions: Float[Tensor, "*n j 4"]) -> Float[Tensor, "*n j 4"]:
    """Parent-relative quaternions `wxyz` of the mirrored pose."""
    return quaternions[..., _pairs(skeleton), :] * quaternions.new_tensor([1.0, 1.0, -1.0, -1.0])


def mirror_positions(positions: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """Mirrored world positions, for example of the root."""
    return positions * positions.new_tensor([-1.0, 1.0, 1.0])


def mirror_features(skeleton: Skeleton, features: Float[Tensor, "*n c"]) -> Float[Tensor, "*n c"]:
    """Motion features (Y up) of the mirrored clip. Only signs and places change, so this is exact."""
    joints, pairs = list(skeleton.feature_joints), _pairs(skeleton)
    if any(pairs[joint] not in joints for joint in joints):
        raise ValueError("a joint and its mirror image must both belong to a body part")
    travel = travel_slice(skeleton)
    six = torch.cat([features[..., : travel.start], features[..., travel.stop :]], -1)
    source = [joints.index(pairs[joint]) for joint in joints]
    six = six.reshape(*six.shape[:-1], len(joints), 6)[..., source, :] * six.new_tensor([1, -1, -1, -1, 1, 1])
    moved = features[..., travel] * features.new_tensor([-1.0, 1.0, 1.0])
    six = six.flatten(-2)
    return torch.cat([six[..., : travel.start], moved, six[..., travel.start :]], -1)


def is_symmetric(skeleton: Skeleton, tolerance: float = 1e-4) -> bool:
    """Whether the rest offsets of every mirror pair are reflections of each other (metres)."""
    offsets = torch.from_numpy(skeleton.offsets)
    return bool((offsets[_pairs(skeleton)] - mirror_positions(offsets)).abs().max() <= tolerance)


def _pairs(skeleton: Skeleton) -> list[int]:
    if len(skeleton.config.mirror) != skeleton.joints:
        raise ValueError("the skeleton has no mirror pairs, so left and right cannot be swapped")
    return list(skeleton.config.mirror)
