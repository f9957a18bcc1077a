import pytest
import torch

from echoavatar.errors import EchoAvatarError
from echoavatar.models.generator import GeneratorConfig
from echoavatar_lab.bench.train import bench_generator, step_flop
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.generator.train import GeneratorTraining

LAYOUT = compact_layout(audio_codes=16, motion_layers=2, motion_codes=8)


def sizes(**changes) -> GeneratorConfig:
    return GeneratorConfig(layout=LAYOUT, width=16, layers=2, heads=2, kv_heads=1, mlp=32, window_chunks=3, **changes)


def test_work_is_counted_by_the_formula() -> None:
    """A layer: q, o 16 x 16, k, v 8 x 16, three of 32 x 16, biases 32, norms 32; per id 6 of each, and 12 L d S."""
    layer = 2 * 256 + 2 * 128 + 3 * 512 + 32 + 32
    assert step_flop(Generator(sizes()), 100, 50) == 100 * (6 * 2 * layer + 12 * 2 * 16 * 50)


@pytest.mark.parametrize("sequence", ["interleaved", "prefix"])
def test_the_share_is_work_over_time_over_rate(sequence: str) -> None:
    training = GeneratorTraining(steps=9, batch=2, accumulation=2, chunks=4, depth_weights=(1.0, 0.5))
    report = bench_generator(sizes(sequence=sequence), training, device="cpu", steps=2)
    assert report.number_format == "float32"
    assert report.share == pytest.approx(report.step_tflop / report.step_seconds / report.matrix_rate)
    assert 0 < report.share < 1
    assert 0 < report.draw_share < 1


@pytest.mark.skipif(torch.cuda.is_available(), reason="says what is missing where there is no GPU")
def test_a_device_that_is_not_there_is_named() -> None:
    training = GeneratorTraining(steps=9, batch=2, chunks=4, depth_weights=(1.0, 0.5))
    with pytest.raises(EchoAvatarError, match="no CUDA device"):
        bench_generator(sizes(), training, device="cuda", steps=1)
