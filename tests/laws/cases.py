"""Every streaming class of the package: how the laws run it, or which other class's case runs it.

A streaming class is one with a method `init_...(rows)` that makes the state of some sessions. A new one needs an entry.
"""

import math
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scripts.synthetic_release import skeleton
from tests.models.face import tiny as face
from tests.models.generator import tiny as generators
from tests.models.motion_tokens import fill, small_body
from tests.tiny_bundle import write_bundle
from torch import Tensor

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.foreign_rig import RigAdapter
from echoavatar.models.audio import CodecConfig, LevelControl
from echoavatar.models.face import FaceStream, HubertConfig
from echoavatar.models.face.decoder import FrameDecoder
from echoavatar.models.face.idle import IdleFace
from echoavatar.models.generator.frames import FrameStream
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID, Skeleton, to_features
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar.motion.motion_chunk import MotionBatch
from echoavatar.motion.stages.feet import Feet
from echoavatar.motion.stages.ground import Ground
from echoavatar.motion.stages.leash import Leash
from echoavatar.motion.stages.modes import FREE, IdleLegs, MotionOptions
from echoavatar.motion.stages.post import Post
from echoavatar.motion.stages.smoother import Smoother, SpeedLimit
from echoavatar.motion.stages.stillness import Stillness
from echoavatar.nn.exported import ExportedStep
from echoavatar.timing import CHUNK_FRAMES, CHUNK_SAMPLES
from echoavatar_lab import checkpoint
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.export import export_step
from echoavatar_lab.models.face.encoder import HubertEncoder, MelEncoder
from echoavatar_lab.models.face.window import WindowFrames
from echoavatar_lab.models.generator.stream import DepthStream, InterleavedStream, PrefixStream, open_stream
from echoavatar_lab.models.tokenizer.model import BodyTokenizer, MotionTokenizer
from echoavatar_lab.nn.attention import CausalAttention
from echoavatar_lab.nn.blocks import CausalBlock
from echoavatar_lab.nn.torch_step import TorchStep
from echoavatar_lab.reference.release_rig import rig_config, skeleton_config

Cuts = Sequence[Sequence[int]]
TOKENIZER = MotionTokenizerConfig(features=10, width=16, heads=2, layers=3, codes=24)
EAR = HubertConfig(width=16, layers=1, heads=2, mlp=16, convolutions=(4,) * 7, position_kernel=4, position_groups=2)
FEW: Cuts = ((3, 1, 4), (1, 1, 2))


@dataclass
class Stream:
    """A class's own methods under the names that the laws call."""

    init_state: Callable[[int], Any]
    step: Callable[[Tensor, Any, Tensor], Tensor]
    whole: Callable[[Tensor], Tensor] | None = None  # else one step from a fresh state

    def __call__(self, x: Tensor) -> Tensor:
        if self.whole is not None:
            return self.whole(x)
        return self.step(x, self.init_state(len(x)), torch.ones(len(x), dtype=torch.bool))


@dataclass(frozen=True)
class Case:
    """`make(rows, frames, generator)` draws input; `unit` frames are the smallest step."""

    stream: Callable[[], Any]
    make: Callable[[int, int, torch.Generator], Tensor]
    unit: int = 1
    cuts: Cuts = ((1, 1, 1, 1, 1, 1, 1, 1), (3, 1, 4), (2, 6), (7, 1))
    atol: float = 1e-6


def on_arrays(step: Callable[..., Any]) -> Callable[[Tensor, Any, Tensor], Tensor]:
    """A step that takes and gives arrays, for the laws' tensors."""
    return lambda x, state, active: torch.from_numpy(step(x.numpy(), state, active.numpy()))


def in_chunks(step: Callable[[Tensor, Any, Tensor], Tensor], size: int) -> Callable[[Tensor, Any, Tensor], Tensor]:
    """A step that takes any number of chunks, for a class whose own step takes one."""

    def many(x: Tensor, state: Any, active: Tensor) -> Tensor:
        return torch.cat([step(part, state, active) for part in x.split(size, 1)], 1)

    return many


def numbers(*sizes: int) -> Callable[[int, int, torch.Generator], Tensor]:
    """Normal noise (rows, frames, *sizes) in double precision."""
    return lambda rows, frames, random: torch.randn(rows, frames, *sizes, generator=random, dtype=torch.double)


def codes(book: int, *sizes: int) -> Callable[[int, int, torch.Generator], Tensor]:
    return lambda rows, frames, random: torch.randint(book, (rows, frames, *sizes), generator=random)


def seeded(module: Callable[..., Any], **sizes: int) -> Callable[[], Any]:
    """Its weights are drawn from seed 0, in double precision."""

    def made() -> Any:
        torch.manual_seed(0)
        return module(**sizes).double().eval()

    return made


def tokenizer() -> MotionTokenizer:
    torch.manual_seed(0)
    model = MotionTokenizer(TOKENIZER).double()
    fill(model.quantizer)
    return model.eval()


def encoding(model: MotionTokenizer) -> Stream:
    """Held to the bit: latents could hide behind codes, and a code may jump at a tie."""

    def step(x: Tensor, state: Any, active: Tensor) -> Tensor:
        return model.quantizer.encode(model.latents_step(x, state, active))

    return Stream(model.init_encoder, step, model.encode)


def whole_body() -> Stream:
    model = small_body().double()
    return Stream(model.init_encoder, model.encode_step, model.encode)


def decoding(model: MotionTokenizer | BodyTokenizer) -> Stream:
    return Stream(model.init_decoder, model.decode_step, model.decode)


def telling_apart(codec: AudioCodec) -> AudioCodec:
    """With code vectors that tell sounds apart: some of its own latents."""
    noise = sound(1, 48_000, torch.Generator().manual_seed(0)).to(codec.codebooks)
    with torch.no_grad():
        latents = codec.latents(noise, codec.init_state(len(noise)), torch.ones(len(noise), dtype=torch.bool))[0]
    codec.codebooks[0] = latents[:: len(latents) // 16][:16]
    return codec


def codec() -> Stream:
    torch.manual_seed(0)
    model = telling_apart(AudioCodec(CodecConfig(filters=2, width=8, codes=16)).double().eval())
    return Stream(model.init_state, model.step, model.encode)


def sound(rows: int, samples: int, random: torch.Generator) -> Tensor:
    """Ten times a second a tone of another pitch and loudness, or noise."""
    loud, pitch, is_noise = torch.rand(3, rows, -(-samples // 2400), 1, generator=random)
    time = torch.arange(2400) / 24_000
    tone = torch.sin(2 * math.pi * (100 + 3_000 * pitch**2) * time)
    made = loud * torch.where(is_noise < 0.3, torch.randn(*tone.shape, generator=random), tone)
    return made.flatten(1)[:, :samples]


def quiet(rows: int, samples: int, random: torch.Generator) -> Tensor:
    return 0.02 * sound(rows, samples, random)


def level() -> Stream:
    control = LevelControl()
    return Stream(control.init_state, on_arrays(control.step), lambda x: torch.from_numpy(control(x.numpy())))


def hubert() -> Stream:
    """Each chunk's own frames of the window; `forward` hears a clip in the same way."""
    torch.manual_seed(0)
    encoder = HubertEncoder(EAR).eval()

    def step(x: Tensor, state: Any, active: Tensor) -> Tensor:
        return encoder.step(x, state, active)[:, -CHUNK_FRAMES:]

    return Stream(encoder.init_state, in_chunks(step, CHUNK_SAMPLES), encoder)


def face_stream(memory: str) -> Any:
    return face.Seeded(face.make(face.CONFIG.model_copy(update={"memory": memory})))


def idle_face() -> Stream:
    """Over curves that rest, for a loudness."""
    model = IdleFace(np.zeros(52, np.bool_))

    def step(loudness: np.ndarray, state: Any, active: np.ndarray) -> np.ndarray:
        still = np.zeros((*loudness.shape, 52), np.float32)
        return model.step(still, loudness, state, active, np.arange(len(loudness)))

    return Stream(model.init_state, on_arrays(step))


def exported(model: Any, step: Any, init_state: Any, x: Tensor) -> Stream:
    """The step of a model as a graph; `x` is one chunk."""
    with tempfile.TemporaryDirectory() as folder:
        checkpoint.save(Path(folder), config=model.config, weights=model.state_dict(), card={})
        graph = ExportedStep(export_step(Path(folder), model, step, init_state, x))
    return Stream(graph.init_state, in_chunks(on_arrays(graph.step), x.shape[1]))


def exported_decoder() -> Stream:
    model = tokenizer().float()
    return exported(model, model.decode_step, model.init_decoder, torch.randint(24, (2, 2, 3)))


def exported_ear() -> Stream:
    torch.manual_seed(0)
    model = MelEncoder(face.EAR).eval()
    return exported(model, model.step, model.init_state, sound(2, CHUNK_SAMPLES, torch.Generator().manual_seed(0)))


def exported_codec() -> Stream:
    torch.manual_seed(0)
    model = telling_apart(AudioCodec(CodecConfig(filters=2, width=8, codes=16)).eval())
    return exported(model, model.step, model.init_state, sound(2, CHUNK_SAMPLES, torch.Generator().manual_seed(0)))


def generator(sequence: str) -> Any:
    return open_stream(generators.generator(sequence=sequence, window_chunks=2))


def frames() -> Stream:
    model = generators.generator(sequence="depth", window_chunks=2)
    stream = FrameStream(model.config, {name: weight.numpy() for name, weight in model.state_dict().items()})
    return Stream(stream.init_state, on_arrays(stream.step))


def gestures(rows: int, frames: int, random: torch.Generator) -> Tensor:
    """Features of bodies that sway, step and wave, with noise as sampled codes leave it."""
    time = torch.arange(frames) / 30
    turns = torch.zeros(rows, frames, HUMANOID.joints, 3)
    phase = 6 * torch.rand(rows, 1, generator=random)
    wave = torch.sin(2 * math.pi * 0.9 * time + phase)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turns[..., HUMANOID.index(f"{side}UpperArm"), 2] = -sign * (1.0 + 0.2 * wave)
        turns[..., HUMANOID.index(f"{side}LowerArm"), 1] = -sign * (1.4 + 0.5 * wave)
        knee = (sign * wave).clamp_min(0) * 0.5
        turns[..., HUMANOID.index(f"{side}UpperLeg"), 0] = -knee
        turns[..., HUMANOID.index(f"{side}LowerLeg"), 0] = 2 * knee
        turns[..., HUMANOID.index(f"{side}Foot"), 0] = -knee
    turns += 0.03 * torch.randn(turns.shape, generator=random)
    root = torch.zeros(rows, frames, 3)
    root[..., 0] = 0.05 * wave
    root[..., 1] = 0.94
    return torch.from_numpy(to_features(HUMANOID, matrix_from_axis_angle(turns.numpy()), root.numpy()))


def post(options: MotionOptions = FREE) -> Stream:
    """All stages behind the decoder, with these options in every row that is active."""
    stages = Post(HUMANOID)

    def step(x: Tensor, state: Any, active: Tensor) -> Tensor:
        state.modes.choose(active.numpy(), options)
        return flat(stages.step(x.numpy(), state, active.numpy()))

    return Stream(stages.init_state, in_chunks(step, CHUNK_FRAMES))


def flat(motion: MotionBatch) -> Tensor:
    """(b, t, joints x 4 + 3): rotations and root."""
    rotations = motion.rotations.reshape(*motion.root.shape[:2], -1)
    return torch.from_numpy(np.concatenate([rotations, motion.root], 2))


def released() -> Skeleton:
    """A rig of 88 joints, as the published release has."""
    names, parents, offsets = skeleton()
    return Skeleton(skeleton_config(names, parents, offsets, origin="test"))


def rig() -> Stream:
    own, same = released(), np.stack([np.eye(3)] * 88)
    adapter = RigAdapter(rig_config(own.config, same, same), own)

    return Stream(adapter.init_state, on_arrays(adapter.step))


def released_features(rows: int, frames: int, random: torch.Generator) -> Tensor:
    turns = matrix_from_axis_angle(0.1 * torch.randn(rows, frames, 88, 3, generator=random).numpy())
    root = (torch.tensor([0.0, -2.0, 95.0]) + torch.randn(rows, frames, 3, generator=random).cumsum(1)).numpy()
    return torch.from_numpy(to_features(released(), turns, root, previous_ground=root[:, 0, :2], up=2))


def pipeline() -> Stream:
    """A whole bundle of random weights, wide enough that every sound matters: sound in, motion out."""
    with tempfile.TemporaryDirectory() as folder:
        bundle = load_bundle(write_bundle(Path(folder)))
        codec, tokenizer, generator = bundle.codec, bundle.tokenizer, bundle.generator
    telling_apart(codec)
    torch.manual_seed(2)
    for parameter in generator.parameters():
        torch.nn.init.normal_(parameter)
    whole = Pipeline(bundle.having(codec=codec, tokenizer=tokenizer, generator=generator), precision="float32")

    def step(x: Tensor, state: Any, active: Tensor) -> Tensor:
        shown = whole.step(x.numpy(), state, active.numpy())
        return flat(
            MotionBatch(*(np.stack(part) for part in zip(*((c.rotations, c.root) for c in shown), strict=True)))
        )

    return Stream(whole.init_state, in_chunks(step, CHUNK_SAMPLES))


CASES: dict[type, dict[str, Case]] = {
    CausalAttention: {"": Case(seeded(CausalAttention, width=16, heads=2, lookback=5), numbers(16))},
    CausalBlock: {"": Case(seeded(CausalBlock, width=16, heads=2, lookback=3), numbers(16))},
    MotionTokenizer: {
        "encoder": Case(lambda: encoding(tokenizer()), numbers(10), unit=4, atol=0),
        "decoder": Case(lambda: decoding(tokenizer()), codes(24, 3)),
    },
    BodyTokenizer: {
        "encoder": Case(whole_body, numbers(315), unit=4, atol=0),
        "decoder": Case(lambda: decoding(small_body().double()), codes(16, 3, 2)),
    },
    AudioCodec: {"": Case(codec, lambda *of: sound(*of).double(), unit=7 * 320, cuts=FEW, atol=0)},
    # Checks of shapes would be traced into the graphs, with the number of rows that they saw.
    ExportedStep: {}
    if os.environ.get("CHECK_SHAPES")
    else {
        "of a decoder": Case(exported_decoder, codes(24, 3), unit=2, cuts=FEW, atol=1e-5),
        "of an ear": Case(exported_ear, sound, CHUNK_SAMPLES, cuts=FEW, atol=1e-5),
        "of a codec": Case(exported_codec, sound, CHUNK_SAMPLES, cuts=FEW, atol=0),
    },
    LevelControl: {"": Case(level, quiet, unit=160 * 30, atol=0)},
    MelEncoder: {"": Case(seeded(MelEncoder, config=face.EAR), face.sound, CHUNK_SAMPLES, cuts=FEW, atol=1e-9)},
    HubertEncoder: {"": Case(hubert, sound, CHUNK_SAMPLES, cuts=FEW, atol=1e-5)},
    FaceStream: {
        "ring": Case(lambda: face_stream("ring"), face.sound, CHUNK_SAMPLES, cuts=FEW[:1], atol=1e-9),
        "window": Case(lambda: face_stream("window"), face.sound, CHUNK_SAMPLES, cuts=FEW[:1], atol=1e-9),
    },
    IdleFace: {"": Case(idle_face, lambda *of: numbers()(*of).abs().clamp(max=1).float(), unit=24)},
    InterleavedStream: {"": Case(lambda: generator("interleaved"), generators.audio, unit=20, cuts=FEW[1:], atol=0)},
    PrefixStream: {"": Case(lambda: generator("prefix"), generators.audio, unit=20, cuts=FEW[1:], atol=0)},
    DepthStream: {"": Case(lambda: generator("depth"), generators.audio, unit=20, cuts=((1, 1, 2),))},
    FrameStream: {"": Case(frames, generators.audio, unit=20, cuts=((1, 1, 2),), atol=0)},
    Post: {
        "free": Case(post, gestures, CHUNK_FRAMES, cuts=FEW, atol=1e-5),
        "on a leash": Case(lambda: post(MotionOptions(leash_m=0.02)), gestures, CHUNK_FRAMES, cuts=FEW, atol=1e-5),
        "upper body": Case(lambda: post(MotionOptions(upper_body=True)), gestures, CHUNK_FRAMES, cuts=FEW, atol=1e-5),
    },
    RigAdapter: {"": Case(rig, released_features, cuts=((3, 1, 4), (1, 7)), atol=2e-5)},
    Pipeline: {"": Case(pipeline, sound, CHUNK_SAMPLES, cuts=FEW[1:], atol=1e-5)},
}

COVERED: dict[type, tuple[type, str]] = {
    TorchStep: (Pipeline, "runs the parts that have no graph"),
    FrameDecoder: (FaceStream, "makes the frames of the ring form"),
    WindowFrames: (FaceStream, "makes the frames of the window form"),
    Smoother: (Post, "runs in every chunk"),
    Stillness: (Post, "runs in every chunk"),
    SpeedLimit: (Post, "runs in every chunk"),
    Ground: (Post, "runs in every chunk"),
    Feet: (Post, "runs in every chunk"),
    Leash: (Post, "runs where a leash was asked for"),
    IdleLegs: (Post, "runs where the upper body alone moves"),
}
