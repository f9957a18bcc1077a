import pytest
import torch
from tests.models.motion_tokens import dance, small_config
from tests.models.runs import check_pieces, check_resume, losses

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.stored import read_card
from echoavatar_lab.data.clip import mirror_features
from echoavatar_lab.models.tokenizer.losses import LossWeights
from echoavatar_lab.models.tokenizer.model import BodyTokenizer, MotionTokenizer
from echoavatar_lab.models.tokenizer.train import (
    ROTATION_FLOOR,
    TokenizerTask,
    TokenizerTraining,
    WindowSampler,
    bundle_training,
    clip_features,
    continued,
    floored_statistics,
    joint_reach,
    reach_statistics,
    start_from_principal_axes,
)
from echoavatar_lab.models.tokenizer.variants import AnyTokenizer
from echoavatar_lab.training import Loop, train


def test_the_rate_drops_in_steps():
    training = TokenizerTraining(steps=10, learning_rate=1e-3, warmup=2)
    rates = [training.rate_at(step) for step in (0, 1, 4, 5, 8)]
    assert rates == pytest.approx([5e-4, 1e-3, 1e-3, 1e-4, 1e-5])


def test_going_on_from_a_trained_tokenizer_is_gentler():
    training = bundle_training()
    assert continued(training).learning_rate == pytest.approx(0.3 * training.learning_rate)
    assert continued(training).quantize_from == 0
    assert not continued(training).is_principal_start


def test_windows_are_true_cuts_of_the_clips_or_their_mirror_images():
    clips = [clip_features(HUMANOID, dance(seed, 40)) for seed in range(2)]
    sampler = WindowSampler(HUMANOID, clips, frames=32, is_mirrored=True)
    windows = sampler.draw(40, torch.Generator().manual_seed(0))
    cuts = [clip[start : start + 32] for clip in clips for start in range(9)]
    kinds = []
    for window in windows:
        plain = any(torch.equal(window, cut) for cut in cuts)
        mirrored = any(torch.equal(window, mirror_features(HUMANOID, cut)) for cut in cuts)
        assert plain or mirrored
        kinds.append(plain)
    assert 5 < sum(kinds) < 35


def test_one_generator_decides_everything():
    sampler = WindowSampler(HUMANOID, [clip_features(HUMANOID, dance(0, 80))], frames=32, is_mirrored=True)
    draws = [sampler.draw(8, torch.Generator().manual_seed(4)) for _ in range(2)]
    assert torch.equal(*draws)


def test_every_start_can_be_drawn_and_none_crosses_a_clip_border():
    clips = [torch.full((34, 315), 1.0), torch.full((33, 315), 2.0), torch.full((10, 315), 3.0)]
    sampler = WindowSampler(HUMANOID, clips, frames=32, is_mirrored=False)
    assert sampler.starts.tolist() == [0, 1, 2, 34, 35]


def test_too_short_clips_are_an_error_with_a_remedy():
    with pytest.raises(MotionError, match="longer clips"):
        WindowSampler(HUMANOID, [torch.zeros(20, 315)], frames=32, is_mirrored=False)


def test_quiet_features_are_not_blown_up():
    """A finger that trembles by 0.001 keeps a spread of 0.03; one that never moves is masked."""
    clip = clip_features(HUMANOID, dance(0, 60))
    clip[:, 200] = torch.arange(60) % 2 * 0.002
    clip[:, 201] = 1.0
    statistics = floored_statistics(HUMANOID, [clip], is_mirrored=False)
    assert statistics.std[200] == pytest.approx(ROTATION_FLOOR)
    assert not statistics.varies[201]
    assert statistics.normalize(clip)[:, 201].abs().max() == 0


def test_reach_grows_towards_the_root():
    """An index tip carries its own 5 cm; the joint before it also the 2.3 cm to the tip: sqrt(0.05^2 + 0.023^2)."""
    reach = joint_reach(HUMANOID)
    tip, middle = (HUMANOID.index(f"leftIndex{bone}") for bone in ("Distal", "Intermediate"))
    assert reach[tip] == pytest.approx(0.05)
    assert reach[middle] == pytest.approx((0.05**2 + 0.023**2 + 0.001**2) ** 0.5, rel=1e-4)
    assert reach.argmax() == 0


def test_joints_that_carry_more_of_the_body_get_a_finer_scale():
    """Equal own spread, but the chest carries the arms and the head nothing: its features are divided by less."""
    clip = clip_features(HUMANOID, dance(0, 60))
    plain = floored_statistics(HUMANOID, [clip], is_mirrored=False)
    scaled = reach_statistics(HUMANOID, [clip], is_mirrored=False)
    joints = list(HUMANOID.feature_joints)

    def change(name: str) -> torch.Tensor:
        place = joints.index(HUMANOID.index(name))
        start = 6 * place + (3 if place >= 9 else 0)
        ratio = scaled.std[start : start + 6] ** 2 / plain.std[start : start + 6]
        return ratio.mean()

    expected = joint_reach(HUMANOID)[HUMANOID.index("head")] / joint_reach(HUMANOID)[HUMANOID.index("chest")]
    assert change("chest") / change("head") == pytest.approx(float(expected), rel=1e-3)
    assert torch.equal(scaled.std[54:57], plain.std[54:57])


def test_before_the_first_step_every_frame_is_the_mean_of_its_four():
    """10 features that live on 6 axes, 8 channels: nothing is lost but the motion inside a token."""
    generator = torch.Generator().manual_seed(0)
    frames = torch.randn(400, 6, generator=generator) @ torch.randn(6, 10, generator=generator)
    frames = frames - frames.mean(0)
    tokenizer = MotionTokenizer(MotionTokenizerConfig(features=10, width=8, heads=2))
    start_from_principal_axes(tokenizer, frames)
    x = frames[None, :64]
    with torch.no_grad():
        found = tokenizer.from_latents(tokenizer.to_latents(x))
    mean = x.view(1, 16, 4, 10).mean(2).repeat_interleave(4, 1)
    torch.testing.assert_close(found, mean, atol=1e-4, rtol=0)


def test_every_branch_still_learns():
    tokenizer = MotionTokenizer(MotionTokenizerConfig(features=10, width=16, heads=2))
    frames = torch.randn(64, 10, generator=torch.Generator().manual_seed(0))
    start_from_principal_axes(tokenizer, frames)
    (tokenizer.from_latents(tokenizer.to_latents(frames[None])) - frames).square().mean().backward()
    branches = [tokenizer.encoder[0].attn.proj, tokenizer.down_sample[0].fc2, tokenizer.up_sample[1].fc2]
    assert all(layer.weight.grad.abs().sum() > 0 for layer in branches)


def test_axes_need_a_short_path():
    tokenizer = AnyTokenizer(MotionTokenizerConfig(features=10, width=16, heads=2, resampling="learned"))
    with pytest.raises(ValueError, match="principal start"):
        start_from_principal_axes(tokenizer, torch.zeros(8, 10))


TRAINING = TokenizerTraining(
    steps=6, batch=4, frames=32, learning_rate=1e-3, warmup=2, log_every=1, evaluate_every=4, dropout=0.5
)
CLIPS = [dance(seed, 80) for seed in range(2)]


def test_training_learns_and_leaves_a_usable_checkpoint(tmp_path):
    training = TRAINING.model_copy(
        update={"steps": 30, "temperature": 0.0, "dropout": 0.0, "learning_rate": 5e-3, "log_every": 5}
    )
    train(
        TokenizerTask(small_config(), training, CLIPS, tests=[dance(9, 64)], card={"licence": "Apache-2.0"}), tmp_path
    )
    assert losses(tmp_path)[30] < 0.9 * losses(tmp_path)[5]
    card = read_card(tmp_path)
    assert card["licence"] == "Apache-2.0"
    assert card["scores"]["mpjpe_body_mm"] > 0
    assert BodyTokenizer.load(tmp_path).encode(torch.zeros(1, 8, 315)).shape == (1, 2, 3, 2)


def test_a_start_as_an_auto_encoder_fills_the_codebooks_at_the_switch():
    training = TRAINING.model_copy(update={"quantize_from": 1})
    loop = Loop(TokenizerTask(small_config(), training, CLIPS))
    books = loop.stage.tokenizer.tokenizers()["lower"].quantizer.books()
    assert loop.advance()["commitment"] == 0
    assert not books[0].ready
    assert loop.advance()["commitment"] > 0
    assert books[0].ready


def test_a_run_may_begin_with_a_trained_tokenizer(tmp_path):
    """One step at the lower rate changes little: codes stay what they were, and the statistics too."""
    trained = train(TokenizerTask(small_config(), TRAINING, CLIPS), tmp_path / "first").tokenizer
    training = continued(TRAINING).model_copy(update={"steps": 1})
    other = [dance(seed, 80) for seed in (5, 6)]
    after = train(TokenizerTask(small_config(), training, other), tmp_path / "second", start=trained).tokenizer
    torch.testing.assert_close(after.mean, trained.mean)
    x = clip_features(HUMANOID, CLIPS[0])[None]
    agree = (after.eval().encode(x) == trained.eval().encode(x)).float().mean()
    assert agree > 0.9


@pytest.mark.parametrize("at", [1, 5])
def test_a_killed_run_goes_on_to_the_same_curve_to_the_bit(tmp_path, at):
    training = TRAINING.model_copy(update={"quantize_from": 2, "average": 0.5, "save_every": 2})
    check_resume(
        lambda folder, **how: train(TokenizerTask(small_config(), training, CLIPS), folder, **how).tokenizer,
        tmp_path,
        at=at,
    )


def test_pieces_share_one_trajectory():
    """Four windows at once, or one after the other, noise on the choice of codes and dropout included."""

    def make(pieces):
        training = TRAINING.model_copy(update={"accumulation": pieces, "losses": LossWeights(travel=0.02)})
        return TokenizerTask(small_config(), training, CLIPS)

    books = [loop.stage.tokenizer.codebooks() for loop in check_pieces(make, 4, steps=6)]
    torch.testing.assert_close(*books, rtol=1e-3, atol=1e-4)


def test_a_state_of_other_sizes_is_refused(tmp_path):
    Loop(TokenizerTask(small_config(), TRAINING, CLIPS)).save(tmp_path)
    with pytest.raises(CheckpointError, match="another tokenizer config: parts"):
        Loop(TokenizerTask(small_config(width=24), TRAINING, CLIPS)).resume(tmp_path)
