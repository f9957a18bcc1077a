"""Film motion and its sound: MP4 (H.264 and AAC) or WebM (VP9 and Opus, with alpha if asked) through PyAV."""

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from fractions import Fraction
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

import av
import numpy as np
from jaxtyping import Float, UInt8

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import Motion
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.whole_file import whole_file

from .avatar_renderer import AvatarRenderer, Shot
from .character import Character, checked_face, load_character
from .framing import path as camera_path
from .planes import to_planes
from .render import Box

__all__ = ["Shot", "film", "write_film"]

SOUND_RATE_HZ = 48_000
THREADS = 2  # renderers at once
T = TypeVar("T")
_CODECS = {".mp4": ("libx264", "aac"), ".webm": ("libvpx-vp9", "libopus")}
_OPTIONS: dict[str, dict[str, str]] = {
    # The preset's search costs a fifth more, as do more threads: no difference is seen, nor in the size of the file.
    ".mp4": {
        "threads": "1",
        "preset": "veryfast",
        "crf": "20",
        "x264-params": "me=dia:subme=1:b-adapt=0:weightp=0:weightb=0:scenecut=0",
    },
    ".webm": {"deadline": "realtime", "cpu-used": "7", "row-mt": "1", "crf": "24", "b": "0"},
}


def write_film(
    path: Path,
    motion: Motion,
    audio: Float[np.ndarray, " s"],
    *,
    face: Float[np.ndarray, "t n"] | None = None,
    character: Character | None = None,
    shot: Shot | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Film the character into .mp4 or .webm. `audio` is mono at 24 kHz and starts with the first frame.

    `face` holds blendshape weights beside the motion; None is a still face.

    Raises:
        MotionError: the file cannot be written, the suffix has no alpha channel, a side of the shot is odd or empty,
            there is no such background, or the face does not fit the motion.
        DependencyError: the shot's renderer is `gpu`, and there is no OpenGL.
    """
    shot, suffix, character = shot or Shot(), path.suffix.lower(), character or load_character()
    if any(side % 2 or side < 2 for side in shot.size):
        wide, high = shot.size
        raise MotionError(f"a film of {wide} x {high} pixels cannot be; width and height are even, 2 or more")
    if shot.alpha and suffix != ".webm":
        raise MotionError(f"{path.name} cannot hold an alpha channel; write .webm")
    curves = None if face is None else checked_face(face, motion.frames, len(character.face.names))
    renderer = AvatarRenderer(character, shot)
    frames = _drawn(renderer, motion, curves, _Converter(renderer.backdrop))
    with (
        whole_file(path, error=MotionError, failures=(av.error.FFmpegError,)) as partial,
        av.open(f"file:{partial}", "w", format=suffix[1:]) as container,
    ):
        _encode(container, frames, motion, audio, shot, suffix, progress)


def film(
    motion: Motion,
    *,
    face: Float[np.ndarray, "t n"] | None = None,
    character: Character | None = None,
    shot: Shot | None = None,
) -> Generator[UInt8[np.ndarray, "h w c"], None, None]:
    """The pictures of a motion on the character's skeleton, frame by frame, drawn by two threads."""
    first = AvatarRenderer(character or load_character(), shot or Shot())
    return _drawn(first, motion, face, lambda picture, _: picture)


def _drawn(
    first: AvatarRenderer,
    motion: Motion,
    face: Float[np.ndarray, "t n"] | None,
    finished: Callable[[UInt8[np.ndarray, "h w c"], tuple[Box, ...]], T],
) -> Generator[T, None, None]:
    """`finished` of each frame's picture and of the boxes around what is drawn there, called in the drawing thread."""
    idle: SimpleQueue[AvatarRenderer] = SimpleQueue()
    for renderer in (first, *(first.twin() for _ in range(THREADS - 1))):
        idle.put(renderer)
    rotations, positions = motion.pose()
    cameras = camera_path(first.shot.view, first.shot.size, first.character, rotations, positions, motion.fps)

    def drawn(frame: int) -> T:
        renderer = idle.get()
        try:
            weights = None if face is None else face[frame]
            return finished(renderer.draw(rotations[frame], positions[frame], weights, cameras[frame]), renderer.drawn)
        finally:
            idle.put(renderer)

    waiting: deque[Future[T]] = deque()
    with ThreadPoolExecutor(THREADS) as threads:
        for frame in range(motion.frames):
            waiting.append(threads.submit(drawn, frame))
            if len(waiting) > 2 * THREADS:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


class _Converter:
    """Pictures as the encoder takes them, of which only the drawn part is converted anew; for several threads."""

    def __init__(self, backdrop: UInt8[np.ndarray, "h w c"]) -> None:
        high, wide, channels = backdrop.shape
        self._empty = av.VideoFrame(wide, high, "yuva420p" if channels == 4 else "yuv420p")
        _fill(self._empty, backdrop, (0, 0, wide, high))

    def __call__(self, picture: UInt8[np.ndarray, "h w c"], boxes: tuple[Box, ...]) -> av.VideoFrame:
        """The picture, which differs from the backdrop inside the boxes alone."""
        frame = av.VideoFrame(self._empty.width, self._empty.height, self._empty.format.name)
        for plane, empty in zip(_planes(frame), _planes(self._empty), strict=True):
            plane[:] = empty
        for left, top, right, bottom in boxes:
            _fill(frame, picture, (left // 2 * 2, top // 2 * 2, -(-right // 2) * 2, -(-bottom // 2) * 2))
        return frame


def _planes(frame: av.VideoFrame) -> list[UInt8[np.ndarray, "h line"]]:
    """The frame's own memory, plane by plane."""
    buffers: Any = frame.planes
    return [np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size) for plane in buffers]


def _fill(frame: av.VideoFrame, picture: UInt8[np.ndarray, "h w c"], box: Box) -> None:
    planes = _planes(frame)
    to_planes(picture, box, *planes[:3])
    if len(planes) == 4:
        left, top, right, bottom = box
        planes[3][top:bottom, left:right] = picture[top:bottom, left:right, 3]


def _encode(
    container: "av.container.OutputContainer",
    frames: Generator[av.VideoFrame, None, None],
    motion: Motion,
    audio: Float[np.ndarray, " s"],
    shot: Shot,
    suffix: str,
    progress: Callable[[int, int], None] | None,
) -> None:
    rate = Fraction(motion.fps).limit_denominator(1001)
    codec, sound_codec = _CODECS[suffix]
    video = container.add_stream(codec, rate=rate)
    assert isinstance(video, av.VideoStream)
    video.width, video.height = shot.size
    video.pix_fmt = "yuva420p" if shot.alpha else "yuv420p"
    video.options = dict(_OPTIONS[suffix])
    sound = container.add_stream(sound_codec, rate=SOUND_RATE_HZ, layout="mono")
    assert isinstance(sound, av.AudioStream)
    with closing(frames):
        for index, frame in enumerate(frames):
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
    form = "flt" if stream.codec_context.name == "libopus" else "fltp"  # what each encoder takes
    for start in range(0, len(samples), 960):
        frame = av.AudioFrame.from_ndarray(samples[None, start : start + 960], format=form, layout="mono")
        frame.sample_rate, frame.pts, frame.time_base = SOUND_RATE_HZ, start, Fraction(1, SOUND_RATE_HZ)
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))
