"""Whole clips to codes and back by the tokenizer's streaming steps: graphs beside its weights, or the lab's module."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from echoavatar.motion.kinematics import Skeleton
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN

from .tokenizer_config import BodyTokenizerConfig


class ClipTokenizer:
    """Motion features (315 channels for our rig) <-> codes of every part and layer, four frames a token."""

    def __init__(self, config: BodyTokenizerConfig, encoder: Any, decoder: Any, *, tokens: int) -> None:
        """`encoder` and `decoder` are steps of arrays (see `ExportedStep`), of so many motion tokens each."""
        self.config, self.skeleton = config, Skeleton(config.skeleton)
        self._encoder, self._decoder, self._tokens = encoder, decoder, tokens

    def encode(self, features: Float[np.ndarray, "t c"]) -> Int[np.ndarray, "n p q"]:
        """The codes of a clip; raises ValueError if its number of frames is not a multiple of four."""
        tokens, rest = divmod(len(features), FRAMES_PER_MOTION_TOKEN)
        if rest:
            raise ValueError(f"{len(features)} frames are not a multiple of {FRAMES_PER_MOTION_TOKEN}")
        return self._run(self._encoder, features, FRAMES_PER_MOTION_TOKEN * self._tokens)[:tokens]

    def decode(self, codes: Int[np.ndarray, "n p q"]) -> Float[np.ndarray, "t c"]:
        """The features of codes; a code of -1 adds nothing, as if its layer were missing."""
        return self._run(self._decoder, codes, self._tokens)[: FRAMES_PER_MOTION_TOKEN * len(codes)]

    def _run(self, step: Any, x: Shaped[np.ndarray, "t ..."], each: int) -> Shaped[np.ndarray, "n ..."]:
        """Run over the clip step by step. The last frame is repeated to fill the last step: steps are causal."""
        filled = np.concatenate([x, np.repeat(x[-1:], -len(x) % each, 0)])
        state, everyone = step.init_state(1), np.ones(1, np.bool_)
        made = [step.step(piece[None], state, everyone)[0] for piece in np.split(filled, len(filled) // each)]
        return np.concatenate(made)
