import torch
from tests.models.audio.small_codec import ours, reference

from echoavatar_lab.models.audio.decoding import decode


def test_sound_equals_that_of_transformers(tmp_path):
    """The outside witness: EncodecModel.decode, in float64, on 60 frames."""
    model = reference(pad_mode="reflect")
    codec = ours(model, tmp_path).double()
    model = model.double()
    codes = torch.randint(16, (2, 60, 2), generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        sound = model.decode(codes.transpose(1, 2)[None], [None]).audio_values[:, 0]
    torch.testing.assert_close(decode(codec, codes), sound, atol=1e-6, rtol=0)


def test_no_codes_give_no_sound(tmp_path):
    codec = ours(reference(pad_mode="constant"), tmp_path)
    assert decode(codec, torch.zeros(1, 0, 2, dtype=torch.int64)).shape == (1, 0)
