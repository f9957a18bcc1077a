import numpy as np
import torch

from echoavatar.models.audio import AudioCodec, CodecConfig
from echoavatar.models.audio.score import _correlation, _si_sdr_db, score_codec


def test_si_sdr_ignores_scale_and_counts_noise():
    """Noise of a tenth of the amplitude is 20 dB down."""
    torch.manual_seed(0)
    sound, noise = torch.randn(1, 24_000), torch.randn(1, 24_000)
    assert float(_si_sdr_db(3 * sound, sound)) > 80
    assert abs(float(_si_sdr_db(sound + 0.1 * noise, sound)) - 20) < 0.3
    assert float(_si_sdr_db(noise, sound)) < -20


def test_correlation_of_equal_and_opposite_spectra():
    x = torch.randn(1, 5, 8)
    assert abs(float(_correlation(x, x)) - 1) < 1e-6
    assert abs(float(_correlation(-x, x)) + 1) < 1e-6


def test_a_codec_with_one_code_is_found_out():
    codec = AudioCodec(CodecConfig(filters=2, width=8, codes=16)).eval()
    rng = np.random.default_rng(0)
    score = score_codec(codec, [rng.standard_normal(9_600).astype(np.float32) * 0.1])
    assert score.usage == (0.062, 0.062)
    assert score.perplexity == (1.0, 1.0)
    assert score.seconds == 0.4
    assert score.log_mel_silence > 1
