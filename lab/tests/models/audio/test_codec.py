import pytest
import torch
from safetensors.torch import load_file
from tests.models.audio.small_codec import ours, reference

from echoavatar.models.audio import CodecConfig
from echoavatar_lab import checkpoint
from echoavatar_lab.models.audio.codec import AudioCodec, nearest_codes


@pytest.fixture(scope="module", params=["reflect", "constant"])
def pair(request, tmp_path_factory):
    model = reference(pad_mode=request.param)
    return ours(model, tmp_path_factory.mktemp("encodec")).double(), model.double()


def test_codes_equal_those_of_transformers(pair):
    """The outside witness: EncodecModel.encode, in float64, on 60 frames."""
    codec, model = pair
    audio = torch.randn(2, 320 * 60, dtype=torch.double) * 0.1
    with torch.no_grad():
        wanted = model.encode(audio[:, None], bandwidth=0.9).audio_codes[0]
    assert torch.equal(codec.encode(audio), wanted.transpose(1, 2))


def test_long_clips_are_encoded_in_blocks_without_a_seam(pair, monkeypatch):
    codec, _ = pair
    audio = torch.randn(1, 320 * 60, dtype=torch.double) * 0.1
    whole = codec.encode(audio)
    monkeypatch.setattr("echoavatar_lab.models.audio.codec._BLOCK_SAMPLES", 320 * 25)
    assert torch.equal(codec.encode(audio), whole)


def test_a_ragged_end_is_filled_with_silence_and_nothing_gives_nothing(pair):
    codec, _ = pair
    audio = torch.randn(1, 3_000, dtype=torch.double)
    filled = torch.nn.functional.pad(audio, (0, 200))
    assert torch.equal(codec.encode(audio), codec.encode(filled))
    assert codec.encode(audio).shape == (1, 10, 2)
    assert codec.encode(audio[:, :0]).shape == (1, 0, 2)


def test_ten_milliseconds_of_sound_can_be_encoded(pair):
    codec, model = pair
    audio = torch.randn(1, 320, dtype=torch.double)
    with torch.no_grad():
        wanted = model.encode(audio[:, None], bandwidth=0.9).audio_codes[0].transpose(1, 2)
    assert torch.equal(codec.encode(audio), wanted)


def test_steps_that_cannot_be_exact_are_refused(pair):
    codec, _ = pair
    state, active = codec.init_state(1), torch.ones(1, dtype=torch.bool)
    with pytest.raises(ValueError, match="multiple of 320 samples, got 6401"):
        codec.step(torch.zeros(1, 6_401), state, active)
    if codec.config.padding == "reflect":
        with pytest.raises(ValueError, match="needs 7 frames, got 6"):
            codec.step(torch.zeros(1, 1_920), state, active)


def test_nearest_code_stands_up_to_a_large_common_part():
    """Rows 1e-3 apart at a distance of 1e3: |x|^2 - 2xe + |e|^2 uncentred is off by about 0.1 in float32."""
    generator = torch.Generator().manual_seed(1)
    book = 1_000 + 1e-3 * torch.randn(64, 8, generator=generator)
    vectors = book[None, torch.randperm(64, generator=generator)]
    truth = (vectors[0, :, None].double() - book.double()).square().sum(-1).argmin(-1)
    assert torch.equal(nearest_codes(vectors, book)[0], truth)
    naive = (book.square().sum(-1) - 2 * vectors[0] @ book.T).argmin(-1)
    assert not torch.equal(naive, truth)


def test_checkpoint_round_trip(tmp_path):
    codec = AudioCodec(CodecConfig(filters=2, width=8, codes=16)).eval()
    codec.codebooks.normal_()
    checkpoint.save(tmp_path, config=codec.config, weights=codec.state_dict(), card={})
    audio = torch.randn(1, 6_400)
    assert torch.equal(AudioCodec.load(tmp_path).encode(audio), codec.encode(audio))
    assert not [name for name in load_file(tmp_path / "model.safetensors") if "parametrizations" in name]
