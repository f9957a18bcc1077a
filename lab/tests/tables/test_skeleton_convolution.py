import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from echoavatar.errors import CheckpointError, MotionError
from echoavatar_lab.tables.skeleton_convolution import (
    SMPLX_PARENTS,
    SkeletonConvolution,
    SkeletonConvolutionConfig,
    SkeletonConvolutionTask,
    SkeletonConvolutionTraining,
    averaging,
    extractor_input,
    merged,
    neighbours,
    skeleton_edges,
)
from echoavatar_lab.training import Loop, train

# a root with a chain of three bones, the last of which branches into two
PARENTS = (-1, 0, 1, 2, 3, 3)


def test_edges_are_numbered_like_joints() -> None:
    assert skeleton_edges(PARENTS) == [(0, 6), (0, 1), (1, 2), (2, 3), (3, 4), (3, 5)]
    assert len(skeleton_edges(SMPLX_PARENTS)) == 55


def test_neighbours_are_counted_along_the_bones() -> None:
    edges = skeleton_edges(PARENTS)
    assert np.flatnonzero(neighbours(edges, 0)[1]).tolist() == [1]
    assert np.flatnonzero(neighbours(edges, 1)[1]).tolist() == [0, 1, 2]
    assert np.flatnonzero(neighbours(edges, 2)[1]).tolist() == [0, 1, 2, 3]
    assert np.flatnonzero(neighbours(edges, 1)[4]).tolist() == [3, 4, 5]


def test_chains_merge_in_pairs_from_their_far_end() -> None:
    """Three bones: the first stays alone. Branches end chains."""
    groups, left = merged(skeleton_edges(PARENTS))
    assert groups == [[0], [1], [2, 3], [4], [5]]
    assert left == [(0, 6), (0, 1), (1, 3), (3, 4), (3, 5)]


def test_averaging_takes_means_channel_by_channel() -> None:
    matrix = averaging([[0], [1, 2]], 3, 2)
    np.testing.assert_allclose(matrix @ np.array([1.0, 2, 3, 4, 5, 6]), [1, 2, 4, 5])


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
    save_file({}, tmp_path / "model.safetensors")
    with pytest.raises(CheckpointError, match="missing"):
        SkeletonConvolution.load(tmp_path)


@pytest.mark.parametrize("shape", [(1, 30, 42), (1, 32, 41), (1, 0, 42)])
def test_what_does_not_fit_is_refused(model: SkeletonConvolution, shape: tuple[int, ...]) -> None:
    with pytest.raises(MotionError, match="cut the clip"):
        model.encode(torch.zeros(shape))


def test_the_extractor_reads_the_first_two_rows_of_each_rotation() -> None:
    """A quarter turn about Z: rows (0, -1, 0) and (1, 0, 0)."""
    half = 0.5**0.5
    read = extractor_input(torch.tensor([[[half, 0.0, 0.0, half]]]))
    torch.testing.assert_close(read, torch.tensor([[0.0, -1.0, 0.0, 1.0, 0.0, 0.0]]), atol=1e-6, rtol=0)


def clips(count: int = 6) -> list[torch.Tensor]:
    """Slow waves, each channel at its own pace."""
    time = torch.arange(96)[:, None] / 30
    paces = torch.linspace(0.5, 2, 42)
    return [torch.sin(time * paces + shift) for shift in range(count)]


def settings(**changes: object) -> SkeletonConvolutionTraining:
    usual = {"steps": 60, "batch": 8, "frames": 32, "warmup": 5, "learning_rate": 5e-3}
    return SkeletonConvolutionTraining.model_validate(usual | changes)


@pytest.mark.slow
def test_it_learns_to_give_motion_back(tmp_path: Path) -> None:
    made = clips()
    model = train(SkeletonConvolutionTask(SMALL, settings(), made), tmp_path).model
    back = model.decode(model.encode(made[0][None]))
    assert (back - made[0]).square().mean() < 0.5 * made[0].var()
    assert len(model.features(made[0])) == 96 // 4


def test_masks_between_strangers_and_unused_heads_stay_as_they_are() -> None:
    stage = SkeletonConvolutionTask(SMALL, settings(), clips())
    before = {name: value.clone() for name, value in stage.model.state_dict().items()}
    Loop(stage).advance()
    after = stage.model.state_dict()
    kept = {name for name in after if name.endswith("mask") or name.startswith(("fc_", "encoder.layers.0.0.common"))}
    assert kept
    assert all(torch.equal(before[name], after[name]) for name in kept)
    assert not torch.equal(
        before["encoder.layers.0.0.residual.0.weight"], after["encoder.layers.0.0.residual.0.weight"]
    )


def test_a_step_draws_the_same_windows_again() -> None:
    one, two = (SkeletonConvolutionTask(SMALL, settings(), clips()) for _ in range(2))
    assert torch.equal(one.draw(3), two.draw(3))
    assert not torch.equal(one.draw(3), one.draw(4))


def test_clips_that_are_too_short_are_refused() -> None:
    with pytest.raises(MotionError, match="32 frames"):
        SkeletonConvolutionTask(SMALL, settings(), [clip[:20] for clip in clips()])
