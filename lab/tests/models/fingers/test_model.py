from pathlib import Path

import pytest
import torch
from lab.tests.models.fingers.moving import TINY
from pydantic import ValidationError

from echoavatar.errors import CheckpointError
from echoavatar_lab.models.fingers.clips import BODY_SIZE
from echoavatar_lab.models.fingers.model import FingerConfig, FingerModel, _windows, load_shipped, sample_hands


@pytest.mark.parametrize("sizes", [{"frames": 30, "patch": 4}, {"width": 36, "heads": 4}, {"poses": 91}])
def test_sizes_that_do_not_fit_are_refused(sizes: dict[str, int]) -> None:
    with pytest.raises(ValidationError, match="must|less than"):
        FingerConfig(**sizes)


def test_unknown_fields_are_refused() -> None:
    with pytest.raises(ValidationError, match="diffusion"):
        FingerConfig(diffusion=True)  # type: ignore[call-arg]


def inputs(rows: int = 2) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    torch.manual_seed(0)
    hands = torch.randn(rows, TINY.frames, 2, TINY.poses)
    unknown = torch.zeros(rows, TINY.frames, 2, dtype=torch.bool)
    return hands, unknown, torch.full((rows,), 0.5), torch.randn(rows, TINY.frames, BODY_SIZE)


def test_every_frame_is_seen_by_every_other_and_rows_do_not_mix() -> None:
    model = FingerModel(TINY)
    hands, unknown, level, body = inputs()
    body.requires_grad_()
    out = model(hands, unknown, level, body)
    assert out.shape == hands.shape
    out[0, 3].sum().backward()
    assert body.grad is not None
    seen = body.grad.abs().sum(-1) > 0
    assert seen[0].all()
    assert not seen[1].any()


def test_the_output_depends_on_known_hands_and_noise_level() -> None:
    model = FingerModel(TINY)
    hands, unknown, level, body = inputs()
    plain = model(hands, unknown, level, body)
    assert not torch.allclose(model(hands, ~unknown, level, body), plain)
    assert not torch.allclose(model(hands, unknown, level / 2, body), plain)


def test_a_model_comes_back_from_its_folder_up_to_half_precision(tmp_path: Path) -> None:
    model = FingerModel(TINY).eval()
    model.save(tmp_path, {"data": "none"}, dtype=torch.float16)
    again = FingerModel.load(tmp_path)
    torch.testing.assert_close(again(*inputs()), model(*inputs()), atol=5e-3, rtol=5e-3)
    (tmp_path / "config.json").unlink()
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        FingerModel.load(tmp_path)


def test_the_shipped_model_is_small_and_knows_hands() -> None:
    model = load_shipped()
    assert sum(p.numel() for p in model.parameters()) < 1.5e6
    assert (model.hand_scale > 0).all()
    assert model.hand_mean.abs().max() > 0.5


def test_windows_cover_every_frame_and_overlap() -> None:
    for count in (1, 15, 16, 17, 100, 333):
        index = _windows(count, 16, 4)
        assert sorted(set(index.flatten().tolist())) == list(range(count))
        starts = index[:, 0]
        assert len(starts) == 1 or int(starts.diff().max()) <= 8
    assert {int(start) % 4 for start in _windows(100, 16, 4)[:, 0]} > {0}


def test_known_hands_come_back_and_the_seed_decides_the_rest(model: FingerModel) -> None:
    body, known = torch.randn(40, BODY_SIZE), torch.randn(40, 2, TINY.poses)
    is_known = torch.tensor([True, False]).expand(40, 2)
    first, again, other = (sample_hands(model, body, known, is_known, seed=seed) for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert torch.equal(first[:, 0], known[:, 0])
    assert not torch.allclose(first[:, 1], other[:, 1])


def test_a_single_window_gives_the_models_own_output() -> None:
    """One step from pure noise on a clip of one window gives the model's output."""
    torch.manual_seed(0)
    tiny = FingerModel(TINY).eval()
    body, blank = torch.randn(16, BODY_SIZE), torch.zeros(16, 2, TINY.poses)
    none = torch.zeros(16, 2, dtype=torch.bool)
    noise = torch.randn(16, 2, TINY.poses, generator=torch.Generator().manual_seed(5))
    with torch.inference_mode():
        own = tiny(noise[None], none[None], torch.ones(1), tiny.normalize_body(body)[None])[0]
    limit = 4 * tiny.basis.spread
    made = sample_hands(tiny, body, blank, none, seed=5, steps=1)
    torch.testing.assert_close(made, own.clamp(-limit, limit), atol=1e-5, rtol=1e-5)
    assert (made == own).float().mean() > 0.5


def test_there_is_no_seam(model: FingerModel) -> None:
    """Over a long motionless body, steps at window borders are no larger than elsewhere."""
    body = torch.zeros(200, BODY_SIZE) + model.body_mean
    blank, none = torch.zeros(200, 2, TINY.poses), torch.zeros(200, 2, dtype=torch.bool)
    steps = sample_hands(model, body, blank, none, steps=1).diff(dim=0).norm(dim=-1).mean(1)
    starts = _windows(200, TINY.frames, TINY.patch)[1:, 0]
    assert steps[starts - 1].mean() < 1.5 * steps.mean()
