"""Write a bundle from a checked download: configs, safetensors, and a card that names the owner of the weights."""

import json
from pathlib import Path

import torch
from torch import Tensor

from echoavatar.engine.pipeline import ActionLibrary
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.errors import CheckpointError
from echoavatar.models.face.config import ChannelOrder
from echoavatar.models.generator.config import Opening
from echoavatar.models.tokenizer_config import BodyTokenizerConfig
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.whole_file import make_output_folder, write_whole
from echoavatar_lab import checkpoint
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.face.model import FaceModel
from echoavatar_lab.models.tokenizer.model import BodyTokenizer

from .expected_tensors import from_reference
from .inspection import Inspection
from .weights import occurring

SILENCE_SECONDS = 4
WARNING = (
    "The authors published these weights without a licence: all rights are theirs. Use them for what the authors "
    "allow, do not pass this folder on, and do not ship it with anything."
)
ORIGIN = "converted from the authors' release of EchoAvatar (SIGGRAPH 2026); trained by them, on their data"


def convert(
    found: Inspection,
    codec: AudioCodec,
    output: Path,
    *,
    actions: ActionLibrary,
    face_order: ChannelOrder = "apple",
    command: str = "echoavatar import reference",
) -> None:
    """Write the bundle. Raises CheckpointError: the inspection found problems; the message lists them."""
    if found.problems:
        raise CheckpointError("the download does not fit:\n" + "\n".join(found.problems))
    make_output_folder(output)
    card: dict[str, object] = {"data": ORIGIN, "command": command, "licence": "none given; see warning"}
    card["warning"] = WARNING
    checkpoint.save(output / "codec", config=codec.config, weights=codec.state_dict(), card=_codec_card(command))
    _write_tokenizer(found, output / "tokenizer", card)
    _write_generator(found, codec, output / "generator", card)
    _write_face(found, output / "face", card, face_order)
    actions.save(output)
    assert found.rig is not None
    as_published = Runtime(  # no lead-in: a session begins with the generator's `opening`
        level_control=False, lead_in_s=0.0, rig=found.rig
    )
    as_published.save(output)
    write_whole(output / "card.json", json.dumps(card, indent=2) + "\n")


def _write_tokenizer(found: Inspection, folder: Path, card: dict[str, object]) -> None:
    assert found.skeleton is not None
    assert found.statistics is not None
    tokenizer = BodyTokenizer(BodyTokenizerConfig(skeleton=found.skeleton, parts=found.parts))
    weights = {
        f"parts.{part}.{key}": value.float()
        for part, tensors in found.tokenizers.items()
        for key, value in tensors.items()
    }
    weights |= found.statistics._asdict()
    checkpoint.load_into(tokenizer, weights, origin="the release's tokenizers")
    tokenizer.save(folder, card, dtype=torch.float32)


def _write_generator(found: Inspection, codec: AudioCodec, folder: Path, card: dict[str, object]) -> None:
    stored, config = found.generator, found.generator_config
    assert stored is not None
    assert config is not None
    rows = occurring()
    weights: dict[str, Tensor] = {}
    for key, shape in stored.shapes.items():
        weights[key] = stored.read(key, rows if shape[0] == stored.config["vocab_size"] else None)
    if stored.is_tied:
        weights["lm_head.weight"] = weights["model.embed_tokens.weight"].clone()
    assert config.opening is not None
    opening = Opening(silence=silence_codes(codec), motion=config.opening.motion)
    config = config.model_copy(update={"opening": opening, "is_leveled": False})
    checkpoint.save(folder, config=config, weights=weights, card=card)


def _write_face(found: Inspection, folder: Path, card: dict[str, object], order: ChannelOrder) -> None:
    assert found.face is not None
    config = found.face.model_copy(update={"order": order})
    model = FaceModel(config)
    weights = from_reference(found.face_weights)
    own = model.state_dict()
    weights |= {key: own[key] for key in own if key.endswith("masked_spec_embed") and key not in weights}
    weights |= {name: torch.from_numpy(array).float() for name, array in found.face_statistics.items()}
    checkpoint.load_into(model, weights, origin="the release's face model")
    model.save(folder, card)


def silence_codes(codec: AudioCodec) -> tuple[int, ...]:
    """The codes of silence after a few seconds of it, when the codec's state has settled."""
    codes = codec.encode(torch.zeros(1, SILENCE_SECONDS * SAMPLE_RATE_HZ))[0, -1]
    return tuple(int(code) for code in codes)


def _codec_card(command: str) -> dict[str, object]:
    return {
        "data": "EnCodec 24 kHz as published by its authors (facebook/encodec_24khz)",
        "command": command,
        "licence": "that of facebook/encodec_24khz; see its card on the hub",
    }
