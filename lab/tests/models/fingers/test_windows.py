import pytest
import torch
from tests.models.fingers.moving import QUICK, TINY, waving

from echoavatar.models.fingers import FingerModel
from echoavatar.models.fingers.clips import finger_clip
from echoavatar_lab.models.fingers.windows import FingerSampler, count_learned_hands, denoising_loss, draw_noise


def sampler(model: FingerModel, shares: tuple[float, float] = (0.5, 0.5)) -> FingerSampler:
    groups = [[finger_clip(waving(60))], [finger_clip(waving(20, 1)), finger_clip(waving(30, 2, still=("left",)))]]
    return FingerSampler(model, groups, shares, seed=3)


def test_windows_are_the_same_for_the_same_step(model: FingerModel) -> None:
    own = sampler(model)
    one, two, other = own.batch(7, 6), own.batch(7, 6), own.batch(8, 6)
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
    assert not torch.equal(one.hands, other.hands)
    assert one.hands.shape == (6, TINY.frames, 2, TINY.poses)


def test_groups_are_drawn_in_their_shares_and_mirroring_swaps_which_hand_moves(model: FingerModel) -> None:
    assert sampler(model, (1.0, 0.0)).batch(0, 50).is_moving.all()
    seen = sampler(model, (0.0, 1.0)).batch(0, 200)
    one_sided = ~seen.is_moving.all(1)
    assert float(one_sided.float().mean()) == pytest.approx(0.75, abs=0.1)  # 15 of 20 windows
    assert seen.is_moving[one_sided].any(0).all()  # left or right, after mirroring
    still = seen.hands[one_sided].diff(dim=1).abs().amax((1, 3)) < 1e-5
    assert torch.equal(still, ~seen.is_moving[one_sided])


def test_frozen_hands_are_not_learned_from(model: FingerModel) -> None:
    batch = sampler(model, (0.0, 1.0)).batch(0, 32)
    wrong = torch.where(batch.is_moving[:, None, :, None], batch.hands, 100.0)

    def loss(hands: torch.Tensor) -> torch.Tensor:
        noise = draw_noise(batch, torch.Generator().manual_seed(0))
        return denoising_loss(model, batch._replace(hands=hands), QUICK, noise)

    torch.testing.assert_close(loss(wrong), loss(batch.hands))


def test_hands_that_are_given_or_stand_still_do_not_count(model: FingerModel) -> None:
    batch = sampler(model, (0.0, 1.0)).batch(0, 32)
    noise = draw_noise(batch, torch.Generator().manual_seed(0))
    alive = float(batch.is_moving.sum())
    assert count_learned_hands(batch, QUICK.model_copy(update={"one_known": 0.0}), noise) == alive < 64
    assert count_learned_hands(batch, QUICK.model_copy(update={"one_known": 1.0}), noise) < alive
