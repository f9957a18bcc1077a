"""The rows of the release's vocabulary that a prompt can contain, and the token layout over these rows alone.

Of 166,690 rows, six special ids, 2,048 audio codes and 9,216 motion codes can occur. The others are not converted.
"""

import torch
from jaxtyping import Int
from torch import Tensor

from echoavatar.models.tokens import REFERENCE_LAYOUT, TokenLayout


def occurring(layout: TokenLayout = REFERENCE_LAYOUT) -> Int[Tensor, " v"]:
    """Ids of the rows that can occur: special ids ascending, then audio, then motion."""
    audio = torch.arange(layout.audio_layers * layout.audio_codes) + layout.audio_base
    motion = torch.arange(layout.segments * layout.motion_codes) + layout.motion_base
    return torch.cat([torch.tensor(_specials(layout)), audio, motion])


def compacted(layout: TokenLayout = REFERENCE_LAYOUT) -> TokenLayout:
    """The layout renumbered to the rows that `occurring` lists."""
    specials = _specials(layout)
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


def _specials(layout: TokenLayout) -> list[int]:
    used = (layout.start_id, *layout.before_audio, *layout.before_motion, *layout.before_example)
    return sorted({*used, *layout.after_example})
