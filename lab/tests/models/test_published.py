import pytest
from tests.models.audio.small_codec import reference
from tests.models.generator.tiny import generator

from echoavatar.errors import CheckpointError
from echoavatar_lab.models.published import init_from_qwen, read_encodec, read_hubert


def test_missing_encodec_is_one_clear_line(tmp_path):
    with pytest.raises(CheckpointError, match="neither a folder with an EnCodec model nor in the local"):
        read_encodec(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"use_causal_conv": False}, "not the causal"),
        ({"sampling_rate": 48_000}, "24 kHz"),
        ({"normalize": True}, "normalises over time"),
    ],
)
def test_models_that_cannot_stream_are_refused(tmp_path, fields, reason):
    reference(**fields).save_pretrained(tmp_path)
    with pytest.raises(CheckpointError, match=reason):
        read_encodec(str(tmp_path))


def test_a_missing_hubert_and_a_missing_qwen_are_named(tmp_path):
    with pytest.raises(CheckpointError, match="neither a folder with a HuBERT model .* or use the mel encoder"):
        read_hubert(tmp_path / "none")
    with pytest.raises(CheckpointError, match="Qwen2.5-0.5B-Instruct"):
        init_from_qwen(generator(), tmp_path / "nowhere")
