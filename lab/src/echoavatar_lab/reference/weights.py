"""The release's generator, as transformers stores it: a folder of safetensors, of which only needed rows are read.

Of the 166,690 rows of its vocabulary, six special ids, 2,048 audio codes and 9,216 motion codes can occur in a prompt.
The others are not converted: the token layout is over the occurring rows alone.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Int
from safetensors import SafetensorError, safe_open
from torch import Tensor

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.json_reader import read_object_file
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.generator.config import Opening
from echoavatar.models.tokens import TokenLayout
from echoavatar.stored import check_weights
from echoavatar_lab.foreign.foreign_files import check_numbers, want_few

REFERENCE_LAYOUT = TokenLayout(
    audio_layers=2,
    audio_codes=1024,
    motion_layers=6,
    motion_codes=512,
    start_id=151_644,  # <|im_start|>
    before_audio=(151_644, 872, 198),  # <|im_start|>user\n
    before_motion=(151_645, 198, 151_644, 77_091, 198),  # <|im_end|>\n<|im_start|>assistant\n
    before_example=(151_644, 8_948, 198),  # <|im_start|>system\n
    after_example=(151_645, 198),  # <|im_end|>\n
    audio_base=151_690,
    motion_base=156_690,
    vocabulary=166_690,
)
"""The vocabulary of the authors' release: Qwen2.5's text rows, 5,000 audio rows (2,048 used), 10,000 motion rows."""


def occurring() -> Int[Tensor, " v"]:
    """Ids of the rows that can occur: special ids ascending, then audio, then motion."""
    layout = REFERENCE_LAYOUT
    audio = torch.arange(layout.audio_layers * layout.audio_codes) + layout.audio_base
    motion = torch.arange(layout.segments * layout.motion_codes) + layout.motion_base
    return torch.cat([torch.tensor(_specials()), audio, motion])


def compacted() -> TokenLayout:
    """The release's layout, renumbered to the rows that `occurring` lists."""
    layout, specials = REFERENCE_LAYOUT, _specials()
    rows = {token: row for row, token in enumerate(specials)}

    def renamed(ids: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(rows[token] for token in ids)

    motion_base = len(specials) + layout.audio_layers * layout.audio_codes
    return layout.model_copy(
        update={
            "start_id": rows[layout.start_id],
            "before_audio": renamed(layout.before_audio),
            "before_motion": renamed(layout.before_motion),
            "before_example": renamed(layout.before_example),
            "after_example": renamed(layout.after_example),
            "audio_base": len(specials),
            "motion_base": motion_base,
            "vocabulary": motion_base + layout.segments * layout.motion_codes,
        }
    )


def _specials() -> list[int]:
    layout = REFERENCE_LAYOUT
    used = (layout.start_id, *layout.before_audio, *layout.before_motion, *layout.before_example)
    return sorted({*used, *layout.after_example})


SEED_CODE = 32  # the motion code of every segment before the first motion
_ARCHITECTURE = "Qwen2ForCausalLM"


@dataclass(frozen=True)
class StoredGenerator:
    """The header of a folder with Qwen2 weights."""

    folder: Path
    config: dict[str, Any]
    files: dict[str, Path]  # tensor name to the file that contains it
    shapes: dict[str, tuple[int, ...]]

    @classmethod
    def open(cls, folder: Path) -> "StoredGenerator":
        """Read config and headers, but no weights.

        Raises CheckpointError if a file is missing or cut off, or the folder is not a Qwen2.
        """
        try:
            config = read_object_file(folder / "config.json")
        except (OSError, EchoAvatarError) as error:
            raise CheckpointError(f"{folder}/config.json cannot be read ({error}); download it again") from error
        kinds = config.get("architectures", [_ARCHITECTURE])
        if kinds != [_ARCHITECTURE]:
            raise CheckpointError(f"{folder} is a {str(kinds)[:80]}, not a {_ARCHITECTURE}; choose another folder")
        paths = sorted(folder.glob("*.safetensors"))
        if not paths:
            raise CheckpointError(f"{folder} has no *.safetensors; download it again (pickled weights are not read)")
        files: dict[str, Path] = {}
        shapes: dict[str, tuple[int, ...]] = {}
        for path in paths:
            try:
                check_weights(path)
                with safe_open(path, "pt") as stored:
                    for key in want_few(path, stored.keys()):
                        files[key], shapes[key] = path, tuple(stored.get_slice(key).get_shape())
                        if not shapes[key] or 0 in shapes[key]:
                            shape = f"{key[:80]!r} {list(shapes[key])}"
                            raise CheckpointError(f"{path}: {shape} is no matrix or vector; download it again")
            except (SafetensorError, OSError) as error:
                raise CheckpointError(f"{path} is damaged or cut off ({error}); download it again") from error
        return cls(folder, config, files, shapes)

    def generator_config(self, *, step: int, silence: tuple[int, ...]) -> GeneratorConfig:
        """Our config for these weights, over the rows that can occur.

        Raises CheckpointError if a size is missing or impossible, or the vocabulary is not the release's.
        """
        theirs = self.config
        try:
            rope = theirs.get("rope_theta") or theirs["rope_parameters"]["rope_theta"]
            rows = theirs["vocab_size"]
            if theirs["num_hidden_layers"] > len(self.shapes):
                raise ValueError(f"{theirs['num_hidden_layers']} layers of {len(self.shapes)} tensors")
            config = GeneratorConfig(
                layout=compacted(),
                sequence="prefix",
                window_chunks=15,
                step=step,
                opening=Opening(silence=silence, motion=SEED_CODE),
                steered=(REFERENCE_LAYOUT.motion_layers, 0),
                example_bias=20.0,
                width=theirs["hidden_size"],
                layers=theirs["num_hidden_layers"],
                heads=theirs["num_attention_heads"],
                kv_heads=theirs["num_key_value_heads"],
                mlp=theirs["intermediate_size"],
                norm_eps=theirs["rms_norm_eps"],
                rope_theta=rope,
                top_p=1.0,
            )
        except (KeyError, ValueError, TypeError) as error:
            raise CheckpointError(f"{self.folder}/config.json does not describe the generator: {error}") from error
        if rows != REFERENCE_LAYOUT.vocabulary:
            raise CheckpointError(
                f"{self.folder}/config.json: vocab_size is {rows}, wanted {REFERENCE_LAYOUT.vocabulary};"
                " choose another folder"
            )
        return config

    @property
    def is_tied(self) -> bool:
        """Whether output head and input embeddings share one table (the paper has two)."""
        return "lm_head.weight" not in self.shapes and bool(self.config.get("tie_word_embeddings"))

    def read(self, key: str, rows: Tensor | None = None) -> Tensor:
        """A tensor, or the given rows of it in the given order.

        Raises CheckpointError if the file is cut off, or holds what is no number.
        """
        try:
            with safe_open(self.files[key], "pt") as stored:
                tensor: Tensor = stored.get_tensor(key)
                read = tensor.clone() if rows is None else torch.as_tensor(tensor[rows])
        except (SafetensorError, OSError) as error:
            raise CheckpointError(f"{self.files[key]} is damaged or cut off ({error}); download it again") from error
        check_numbers(self.files[key], {key: read})
        return read
