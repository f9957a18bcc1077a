import torch
from tests.models.fingers.moving import TINY

from echoavatar.models.fingers import FingerModel
from echoavatar.models.fingers.body_features import BODY_SIZE
from echoavatar.models.fingers.sample import _windows, sample_hands


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
