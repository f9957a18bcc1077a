from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.models.fingers.moving import QUICK, TINY, waving
from tests.models.runs import check_pieces, check_resume, losses

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.stored import read_card
from echoavatar_lab.data.clip import mirror_positions, mirror_quaternions
from echoavatar_lab.kinematics import matrix_from_quaternion, quaternion_from_axis_angle
from echoavatar_lab.models.fingers.clips import body_features, finger_clip
from echoavatar_lab.models.fingers.model import FingerModel
from echoavatar_lab.models.fingers.train import (
    FingerSampler,
    FingerTask,
    FingerTraining,
    count_learned_hands,
    denoising_loss,
    draw_noise,
    mirror_body,
)
from echoavatar_lab.training import Loop, train


def test_the_rate_ends_at_its_final_share() -> None:
    training = FingerTraining(steps=100, warmup=0)
    assert training.rate_at(100) == pytest.approx(0.03 * training.learning_rate)
    assert training.rate_at(0) == pytest.approx(training.learning_rate)


def test_the_mirrored_features_are_those_of_the_mirrored_body() -> None:
    turns = quaternion_from_axis_angle(0.5 * torch.randn(20, HUMANOID.joints, 3).cumsum(0) / 20)
    root = 0.02 * torch.randn(20, 3).cumsum(0) + torch.from_numpy(HUMANOID.offsets[0])
    plain, other = (matrix_from_quaternion(q).numpy() for q in (turns, mirror_quaternions(HUMANOID, turns)))
    mirrored = body_features(other, mirror_positions(root).numpy())
    made = mirror_body(torch.from_numpy(body_features(plain, root.numpy())))
    np.testing.assert_allclose(made, mirrored, atol=1e-5, rtol=1e-4)


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


def test_a_killed_run_repeats_the_curve_it_would_have_had(tmp_path: Path) -> None:
    clips, recorded = [finger_clip(waving())], [finger_clip(waving(30, 1))]
    card = {"data": "waving"}
    check_resume(
        lambda folder, **how: train(FingerTask(TINY, QUICK, clips, recorded, card=card), folder, **how).model,
        tmp_path,
        at=3,
    )
    card = read_card(tmp_path / "killed")
    assert (card["data"], card["kind"], card["step"]) == ("waving", "fingers", 6)


def test_pieces_share_one_trajectory() -> None:
    """Four windows at once or one by one, some with a known hand and some with a frozen one."""
    clips = [finger_clip(waving()), finger_clip(waving(seed=1, still=("left",)))]

    def make(pieces: int) -> FingerTask:
        return FingerTask(TINY, QUICK.model_copy(update={"accumulation": pieces, "one_known": 0.5}), clips)

    check_pieces(make, 4)


def test_another_schedule_or_size_is_refused(tmp_path: Path) -> None:
    clips = [finger_clip(waving(20))]
    Loop(FingerTask(TINY, QUICK, clips)).save(tmp_path)
    with pytest.raises(CheckpointError, match="another training config: seed"):
        train(FingerTask(TINY, QUICK.model_copy(update={"seed": 1}), clips), tmp_path)
    with pytest.raises(CheckpointError, match="another fingers config: width"):
        train(FingerTask(TINY.model_copy(update={"width": 64}), QUICK, clips), tmp_path)


def test_a_run_stops_on_time_and_continues_later(tmp_path: Path) -> None:
    clips = [finger_clip(waving(20))]
    train(FingerTask(TINY, QUICK, clips), tmp_path, minutes=0.0)
    assert losses(tmp_path) == {}
    train(FingerTask(TINY, QUICK, clips), tmp_path)
    assert len(losses(tmp_path)) == 6


def test_clips_with_frozen_fingers_are_refused() -> None:
    with pytest.raises(MotionError, match="no clip has fingers that move"):
        FingerTask(TINY, QUICK, [finger_clip(waving(still=("left", "right")))])


def test_training_lowers_the_loss(trained: Path) -> None:
    curve = list(losses(trained).values())
    assert sum(curve[-20:]) < 0.5 * sum(curve[:20])
