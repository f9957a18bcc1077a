import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from echoavatar.errors import CheckpointError, MotionError
from echoavatar_lab.tables.skeleton_convolution import SkeletonConvolution, SkeletonConvolutionConfig, extractor_input

SMALL = SkeletonConvolutionConfig(parents=(-1, 0, 1, 2, 3, 3, 0), channels=(6, 6, 12), groups=3, reach=1)


@pytest.fixture
def model() -> SkeletonConvolution:
    torch.manual_seed(0)
    return SkeletonConvolution(SMALL).eval()


@torch.no_grad()
def test_a_bone_is_heard_by_its_neighbours_only(model: SkeletonConvolution) -> None:
    """Reach 1, one layer, bones 0..6 to groups 0, 1, 23, 4, 5, 6: bone 6 on the root is not seen by 23, 4 and 5."""
    normal = model.encoder.layers[0][0].residual[1]
    model.encoder.layers[0][0].residual[1] = torch.nn.Identity()  # normalisation mixes channels of a group
    x = torch.randn(1, 8, 42)
    moved = x.clone()
    moved[..., 36:] += 1
    one, two = (model.encoder.layers[0](value.transpose(1, 2))[0] for value in (x, moved))
    model.encoder.layers[0][0].residual[1] = normal
    changed = (one - two).abs().amax(-1).reshape(-1, 6).amax(-1) > 1e-6
    assert changed.tolist() == [True, True, False, False, False, True]


def test_time_is_quartered_and_comes_back(model: SkeletonConvolution) -> None:
    latents = model.encode(torch.randn(2, 32, 42))
    assert latents.shape[:2] == (2, 8)
    assert model.decode(latents).shape == (2, 32, 42)
    assert len(model.features(torch.randn(70, 42))) == 64 // 4


def test_weights_come_back_with_and_without_the_prefix(model: SkeletonConvolution, tmp_path: Path) -> None:
    x = torch.randn(1, 32, 42)
    (tmp_path / "config.json").write_text(json.dumps(SMALL.model_dump()))
    weights = {f"module.{key}": value.contiguous() for key, value in model.state_dict().items()}
    save_file(weights, tmp_path / "model.safetensors")
    torch.testing.assert_close(SkeletonConvolution.load(tmp_path).encode(x), model.encode(x))
    with pytest.raises(CheckpointError, match="missing"):
        SkeletonConvolution.from_weights({}, SMALL)


@pytest.mark.parametrize("shape", [(1, 30, 42), (1, 32, 41), (1, 0, 42)])
def test_what_does_not_fit_is_refused(model: SkeletonConvolution, shape: tuple[int, ...]) -> None:
    with pytest.raises(MotionError, match="cut the clip"):
        model.encode(torch.zeros(shape))


def test_the_extractor_reads_the_first_two_rows_of_each_rotation() -> None:
    """A quarter turn about Z: rows (0, -1, 0) and (1, 0, 0)."""
    half = 0.5**0.5
    read = extractor_input(torch.tensor([[[half, 0.0, 0.0, half]]]))
    torch.testing.assert_close(read, torch.tensor([[0.0, -1.0, 0.0, 1.0, 0.0, 0.0]]), atol=1e-6, rtol=0)
