import pytest
from pydantic import ValidationError

from echoavatar.models.face import FaceConfig, HubertConfig
from echoavatar_lab.models.face.train import paper_face


def test_the_paper_has_its_sizes():
    config = paper_face()
    assert (config.width, config.layers, config.heads, config.head_blocks) == (256, 4, 8, 3)
    assert (config.context, config.sampling_steps, config.guidance, config.channels) == (56, 3, 2.0, 52)
    assert isinstance(config.encoder, HubertConfig)
    assert config.encoder.width == 768


def test_either_encoder_survives_the_file():
    for config in (FaceConfig(), paper_face()):
        assert FaceConfig.model_validate_json(config.model_dump_json()) == config


def test_sizes_that_do_not_fit_are_named():
    with pytest.raises(ValidationError, match="width \\(100\\) must be a multiple of heads"):
        FaceConfig(width=100)
    with pytest.raises(ValidationError, match="steps by 4 or 8 frames"):
        FaceConfig(step=6)
    with pytest.raises(ValidationError, match="a step of 4 frames has no 7 later ones"):
        FaceConfig(step=4)
