"""Names and shapes of the published files, against what was recorded of them."""

import json

from tests import golden as fixtures

from echoavatar.models.face import HubertConfig
from echoavatar.models.tokenizer import MotionTokenizerConfig
from echoavatar_lab.reference.expected_tensors import differences, face_shapes, hubert_of, tokenizer_shapes

HUBERT = HubertConfig(
    width=48, layers=2, heads=4, mlp=96, convolutions=(24,) * 7, position_kernel=16, position_groups=4
)


def test_the_face_has_the_152_recorded_tensors_beside_its_ear():
    recorded = json.loads(fixtures.golden("reference_release/face_state_keys.json").read_text())
    own = {
        key: list(shape) for key, shape in face_shapes(64, 52, HUBERT).items() if not key.startswith("audio_encoder")
    }
    assert own == {key: shape for key, (shape, _, _) in recorded.items()}
    assert len(own) == 152


def test_a_tokenizer_has_92_tensors_and_the_published_size():
    shapes = tokenizer_shapes(MotionTokenizerConfig(features=117))
    assert len(shapes) == 92
    assert shapes["encoder.0.attn.qkv.weight"] == (1536, 512)
    assert shapes["quantizer.layers.5.codebook"] == (512, 512)
    assert sum(rows * columns[0] if columns else rows for rows, *columns in shapes.values()) == 33_192_565


def test_the_ears_sizes_are_told_by_its_tensors():
    found = hubert_of(face_shapes(64, 52, HUBERT))
    assert found == HUBERT.model_copy(update={"heads": 1})
    assert hubert_of(face_shapes(64, 52, HubertConfig())) == HubertConfig()


def test_every_difference_is_listed():
    wanted = {"a": (1, 2), "b": (3,), "c": (4,), "masked_spec_embed": (4,)}
    assert differences(wanted, wanted, origin="f") == []
    assert differences({"a": (1, 2), "b": (5,), "d": (1,)}, wanted, origin="f") == [
        "f: c [4] is missing",
        "f: d [1] is unknown",
        "f: b is [5], wanted [3]",
    ]
