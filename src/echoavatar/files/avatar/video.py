"""Film motion and its sound as an MP4 of the shaded character (H.264 and AAC through PyAV)."""

import math
from collections.abc import Callable, Generator
from contextlib import closing
from fractions import Fraction
from pathlib import Path
from typing import Literal, get_args

import av
import numpy as np
from jaxtyping import Float, UInt8

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.timing import SAMPLE_RATE_HZ

from .character import Character, load_character
from .morphs import checked_face
from .render import Camera, Paint, Renderer, Surface
from .skinning import skin

SOUND_RATE_HZ = 48_000
FOLLOW_SECONDS = 0.7  # standard deviation of the window that smooths the camera's path
HEAD = HUMANOID.index("head")
View = Literal["front", "left", "right", "back", "face"]  # left and right are the character's
VIEWS: tuple[View, ...] = get_args(View)
_TURNS = {"front": 0.0, "left": 75.0, "right": -90.0, "back": 180.0}  # degrees of the camera about the body


def write_mp4(
    path: Path,
    motion: Motion,
    audio: Float[np.ndarray, " s"],
    *,
    face: Float[np.ndarray, "t n"] | None = None,
    character: Character | None = None,
    size: tuple[int, int] = (1280, 720),
    samples: int = 2,
    view: View = "front",
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Film the character. `audio` is mono at 24 kHz and starts with the first frame; `size` is even.

    `face` holds blendshape weights beside the motion; None is a still face.

    Raises:
        MotionError: the file cannot be written, or the face does not fit the motion.
    """
    curves = None if face is None else checked_face(face, motion.frames)
    frames = film(motion, face=curves, character=character, size=size, samples=samples, view=view)
    partial = path.with_name(path.name + ".partial")
    try:
        with av.open(str(partial), "w", format="mp4") as container:
            _encode(container, frames, motion, audio, size, progress)
        partial.replace(path)
    except (OSError, av.error.FFmpegError) as error:
        raise MotionError(f"cannot write {path} ({error}); choose another place") from error
    finally:
        partial.unlink(missing_ok=True)


def film(
    motion: Motion,
    *,
    face: Float[np.ndarray, "t n"] | None = None,
    character: Character | None = None,
    size: tuple[int, int] = (1280, 720),
    samples: int = 2,
    camera: Camera | None = None,
    view: View = "front",
) -> Generator[UInt8[np.ndarray, "h w 3"], None, None]:
    """The pictures of a motion, frame by frame.

    Without `camera` the camera smoothly follows the hips, or the head where the face is in view.
    """
    character = character or load_character()
    renderer = Renderer(*size, camera=camera, samples=samples)
    paint = Paint.of(character)
    pose = motion.pose()
    rotations, positions = pose.rotations.numpy(), pose.positions.numpy()
    followed = _smoothed(positions[:, HEAD if view == "face" else 0], motion.fps)
    curves = [None] * motion.frames if face is None else list(face)
    for turned, placed, middle, weights in zip(rotations, positions, followed, curves, strict=True):
        if camera is None:
            renderer.camera = close_up(middle) if view == "face" else _following(middle, view)
        points, normals = skin(character, turned, placed, weights)
        yield renderer.draw(Surface(points, normals, paint))


def close_up(head: Float[np.ndarray, " 3"], *, side: float = 0.10) -> Camera:
    """A camera on the face, placed by the head joint; `side` is its distance to the character's left in metres."""
    x, y, z = (float(value) for value in head)
    return Camera(position=(x + side, y + 0.05, z + 0.82), target=(x, y + 0.03, z), field_of_view=0.33)


def _following(middle: Float[np.ndarray, " 3"], view: View) -> Camera:
    x, z, turn = float(middle[0]), float(middle[2]), math.radians(_TURNS[view])
    beside, before = 0.55, 3.9
    placed = (
        x + beside * math.cos(turn) + before * math.sin(turn),
        z - beside * math.sin(turn) + before * math.cos(turn),
    )
    return Camera(position=(placed[0], 1.35, placed[1]), target=(x, 0.93, z))


def _smoothed(hips: Float[np.ndarray, "t 3"], fps: float) -> Float[np.ndarray, "t 3"]:
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(hips, FOLLOW_SECONDS * fps, axis=0, mode="nearest"))


def _encode(
    container: "av.container.OutputContainer",
    frames: Generator[UInt8[np.ndarray, "h w 3"], None, None],
    motion: Motion,
    audio: Float[np.ndarray, " s"],
    size: tuple[int, int],
    progress: Callable[[int, int], None] | None,
) -> None:
    rate = Fraction(motion.fps).limit_denominator(1001)
    video = container.add_stream("libx264", rate=rate)
    video.width, video.height, video.pix_fmt = *size, "yuv420p"
    video.options = {"preset": "veryfast", "crf": "20"}
    sound = container.add_stream("aac", rate=SOUND_RATE_HZ, layout="mono")
    with closing(frames):
        for index, picture in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = index
            frame.time_base = 1 / rate
            container.mux(video.encode(frame))
            if progress:
                progress(index + 1, motion.frames)
    container.mux(video.encode(None))
    _encode_sound(container, sound, audio)


def _encode_sound(
    container: "av.container.OutputContainer", stream: "av.AudioStream", audio: Float[np.ndarray, " s"]
) -> None:
    import soxr

    samples = soxr.resample(np.asarray(audio, np.float32), SAMPLE_RATE_HZ, SOUND_RATE_HZ)
    for start in range(0, len(samples), 1024):
        frame = av.AudioFrame.from_ndarray(samples[None, start : start + 1024], format="fltp", layout="mono")
        frame.sample_rate, frame.pts, frame.time_base = SOUND_RATE_HZ, start, Fraction(1, SOUND_RATE_HZ)
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))
