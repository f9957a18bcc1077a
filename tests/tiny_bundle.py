"""A bundle of random weights that runs in milliseconds."""

from pathlib import Path

import torch

from echoavatar.models.audio import CodecConfig
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID, Motion, to_features
from echoavatar_lab import checkpoint
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import body_config

CARD: dict[str, object] = {"data": "none, random weights", "command": "tests/tiny_bundle.py", "licence": "Apache-2.0"}


def write_bundle(folder: Path) -> Path:
    """Its statistics are those of a standing body."""
    torch.manual_seed(0)
    codec = AudioCodec(CodecConfig(filters=2, width=8, codes=16))
    checkpoint.save(folder / "codec", config=codec.config, weights=codec.state_dict(), card=CARD)
    template = MotionTokenizerConfig(features=1, width=16, heads=2, layers=2, codes=8)
    tokenizer = BodyTokenizer(body_config(HUMANOID, template))
    standing = Motion.at_rest(HUMANOID)
    tokenizer.mean.copy_(torch.from_numpy(to_features(HUMANOID, standing.matrices(), standing.root)[0]))
    tokenizer.std.fill_(0.02)
    for name, book in tokenizer.named_buffers():
        if name.endswith("codebook"):
            book.normal_()
    tokenizer.save(folder / "tokenizer", CARD)
    layout = compact_layout(audio_codes=16, motion_layers=2, motion_codes=8)
    config = GeneratorConfig(layout=layout, window_chunks=3, width=16, layers=1, heads=2, kv_heads=1, mlp=32)
    Generator(config).save(folder / "generator", CARD)
    return folder
