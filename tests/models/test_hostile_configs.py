"""Sizes in a config that no weights vouch for: they shape buffers and run-time state, so they are bounded."""

import pytest
from pydantic import ValidationError

from echoavatar.config import Config
from echoavatar.models.audio.codec_config import CodecConfig
from echoavatar.models.face.config import FaceConfig, MelConfig
from echoavatar.models.generator.config import GeneratorConfig
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar.models.tokens import TokenLayout
from echoavatar_lab.align.audio_reward import AudioMotionConfig
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoderConfig
from echoavatar_lab.models.fingers.model import FingerConfig
from echoavatar_lab.tables.skeleton_convolution import SkeletonConvolutionConfig

SIZES: list[tuple[type[Config], str]] = [
    *((GeneratorConfig, name) for name in ("window_chunks", "ahead_chunks", "layers", "step")),
    *((FaceConfig, name) for name in ("context", "sampling_steps", "noise_hold", "step")),
    *((MelConfig, name) for name in ("bands", "windows", "blocks", "past")),
    *((FingerConfig, name) for name in ("frames", "patch")),
    *((CodecConfig, name) for name in ("residual_blocks", "dilation_growth", "lstm_layers", "kernel", "last_kernel")),
    *((MotionTokenizerConfig, name) for name in ("lookback", "layers", "kmeans_steps")),
    *((TokenLayout, name) for name in ("audio_layers", "motion_layers", "parts")),
    *((AudioMotionConfig, name) for name in ("motion_channels", "slices")),
    (MotionEncoderConfig, "halvings"),
    (SkeletonConvolutionConfig, "reach"),
]


@pytest.mark.parametrize(("config", "field"), SIZES, ids=lambda value: getattr(value, "__name__", value))
def test_a_size_that_no_machine_holds_is_refused(config: type[Config], field: str) -> None:
    with pytest.raises(ValidationError) as told:
        config.model_validate({field: 10**9})
    assert any(error["loc"][0] == field and error["type"] == "less_than_equal" for error in told.value.errors())


def test_masks_that_no_machine_holds_are_refused() -> None:
    with pytest.raises(ValidationError, match="at most"):
        SkeletonConvolutionConfig(channels=(6, 10**6))
