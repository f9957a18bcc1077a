"""Three lines of Python: a sound becomes an animation that saves and shows itself.

    animation = echoavatar.animate("talk.wav")
    animation.save("talk.glb")
    animation  # in a notebook: a page with the avatar and its sound

May import `files`, `engine` and below.
"""

import functools
import html
import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from echoavatar.engine import AnimatedSound, in_blocks
from echoavatar.engine import animate as animate_blocks
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.files.exports import Take, write_take
from echoavatar.files.exports.formats import FILMS
from echoavatar.models.audio import stream_audio
from echoavatar.models.audio.io import StreamResampler, mixed
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ

if TYPE_CHECKING:
    from echoavatar.files.avatar import Character
    from echoavatar.files.avatar.avatar_renderer import RendererName
    from echoavatar.files.avatar.framing import View
    from echoavatar.files.exports import Rig


class Animation(AnimatedSound):
    """Motion, face and the sound that drove them; see the fields of `engine.AnimatedSound`."""

    __slots__ = ()

    @property
    def take(self) -> Take:
        """Motion, face and sound in the form that the exporters take."""
        return Take(self.motion, self.face, self.audio)

    def save(
        self,
        path: str | Path,
        *,
        rig: "Rig | str | Path | None" = None,
        size: tuple[int, int] | str | None = None,
        view: "View" = "front",
        character: "Character | str | None" = None,
        background: str = "studio",
        alpha: bool = False,
        renderer: "RendererName" = "cpu",
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Write a file; its suffix is its format (.glb, .vrma, .bvh, .mp4, .npz, .csv, .usdz, .fbx ...).

        Args:
            path: where to write.
            rig: your own character or skeleton (.vrm, .glb or .bvh), which then moves; a film shows the character.
            size: width and height of a film (.mp4, .webm) in pixels, or wide, portrait or square; None is wide, or
                square for the views bust and face.
            view: of a film: front, left, right or back of the body, bust, or the face alone.
            character: the character of a film: maya (the default), theo or amara.
            background: of a film: studio, dusk, plain, or a colour such as #00ff00.
            alpha: leave the background of a film (.webm) transparent.
            renderer: of a film: cpu, or gpu.
            progress: is called with the number of frames filmed, and that of all frames.

        Raises:
            EchoAvatarError: the suffix is unknown, the rig does not fit it, or the file cannot be written there.
        """
        if isinstance(rig, str | Path):
            from echoavatar.files.exports import read_rig

            rig = read_rig(Path(rig))
        if Path(path).suffix.lower() not in FILMS:
            write_take(Path(path), self.take, rig=rig)
            return
        from echoavatar.files.avatar import load_character
        from echoavatar.files.avatar.framing import picture_size
        from echoavatar.files.avatar.video import Shot

        who = load_character(character) if isinstance(character, str) else character
        shot = Shot(picture_size(size, view), view, background, alpha, renderer=renderer)
        write_take(Path(path), self.take, rig=rig, character=who, shot=shot, progress=progress)

    def to_numpy(self) -> dict[str, np.ndarray]:
        """`Motion.to_numpy`, and `audio` (s) at 24 kHz and, where there is a face, `face` (t, 52) ARKit curves 0..1."""
        face = {} if self.face is None else {"face": self.face}
        return self.motion.to_numpy() | {"audio": self.audio} | face

    def to_html(self) -> str:
        """A self-contained HTML page, about 3 MB, that plays the avatar and its sound without a network or a server."""
        import soundfile

        from echoavatar.files.avatar import load_character
        from echoavatar.files.avatar.gltf import GltfAnimation, pack_glb
        from echoavatar.files.avatar.page import PageClip, page_text

        motion, sound = self.take.on_humanoid().motion, io.BytesIO()
        soundfile.write(sound, np.clip(self.audio, -1, 1), SAMPLE_RATE_HZ, format="OGG", subtype="VORBIS")
        moving = GltfAnimation("motion", motion.rotations, motion.root, motion.fps, self.face)
        clip = PageClip(f"{motion.seconds:.1f} s", "motion", sound.getvalue())
        return page_text(pack_glb(load_character(), [moving], compact=True), [clip])

    def _repr_html_(self) -> str:
        """The page of `to_html` in an iframe, for notebooks."""
        frame = 'width="100%" height="480" style="border:0" sandbox="allow-scripts" title="EchoAvatar animation"'
        return f'<iframe {frame} srcdoc="{html.escape(self.to_html(), quote=True)}"></iframe>'


def animate(
    sound: str | Path | Float[np.ndarray, "..."],
    *,
    rate: int = SAMPLE_RATE_HZ,
    model: str | Path = "default",
    seed: int = 0,
    fps: float = FRAME_RATE_HZ,
    options: MotionOptions | None = None,
    device: str = "cpu",
    progress: Callable[[float], None] | None = None,
) -> Animation:
    """Motion for a sound file, or for samples: mono (s,) or (s, channels), in [-1, 1] or int16.

    Args:
        sound: any file that FFmpeg reads, or samples.
        rate: samples per second, in Hz; a file states its own.
        model: a shipped bundle, a folder, or OWNER/NAME on the hub. The last one used stays loaded.
        seed: the same seed gives the same motion.
        fps: frames per second.
        options: how the body may move, such as `MotionOptions(in_place=True)`.
        device: where the model runs, as in `load`.
        progress: receives the seconds of motion made so far.

    Raises:
        AudioError: the sound is missing, empty or not sound.
        CheckpointError: there is no such model.
        MotionError: `fps` is below 0.1 or above 1000.
    """
    blocks = stream_audio(sound) if isinstance(sound, str | Path) else in_blocks(_resampled(sound, rate))
    pipeline = _loaded(str(model), device)
    own = options or MotionOptions()
    return Animation(*animate_blocks(pipeline, blocks, seed=seed, fps=fps, options=own, progress=progress))


def _resampled(samples: Float[np.ndarray, "..."], rate: int) -> Float[np.ndarray, " s"]:
    stream = StreamResampler(rate)
    return np.concatenate([stream.push(mixed(np.asarray(samples), rate=rate)), stream.flush()])


@functools.lru_cache(maxsize=1)
def _loaded(model: str, device: str) -> Pipeline:
    """The pipeline of a bundle. Calls can share it, because all changing state belongs to sessions."""
    pipeline = Pipeline(load_bundle(model), device=device)
    pipeline.warm_up()
    return pipeline
