import pytest
import torch
from tests.models.motion_tokens import dance

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.data.clip import mirror_features
from echoavatar_lab.models.tokenizer.windows import (
    ROTATION_FLOOR,
    WindowSampler,
    clip_features,
    floored_statistics,
    joint_reach,
    reach_statistics,
)


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
