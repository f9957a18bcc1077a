"""The alignment reward: InfoNCE by hand, embeddings of unit length, files."""

import math

import numpy as np
import pytest
import torch
from lab.tests.align.moving_bodies import dips, reference_statistics, scene

from echoavatar.errors import CheckpointError
from echoavatar_lab.align.audio_encoders import AudioEncoderConfig
from echoavatar_lab.align.audio_reward import AudioMotion, AudioMotionConfig, info_nce
from echoavatar_lab.data.feature_statistics import FeatureStatistics


def model() -> AudioMotion:
    torch.manual_seed(0)
    return AudioMotion.from_codebooks(
        torch.randn(2, 16, 6), torch.randn(3, 2, 8, 4), width=16, layers=1, heads=2, size=120
    ).eval()


def test_info_nce_by_hand():
    """Two orthogonal pairs at temperature 1: -ln(e / (e + 1)) in both directions."""
    eye = torch.eye(2)
    loss = info_nce(eye, eye, torch.tensor(1.0), torch.tensor([0, 1]))
    assert loss.item() == pytest.approx(-math.log(math.e / (math.e + 1)))
    same = info_nce(eye, eye, torch.tensor(1.0), torch.tensor([0, 0]))
    assert same.item() == pytest.approx(-0.5 * math.log(math.e / (math.e + 1)) - 0.5 * math.log(1 / (math.e + 1)))


def test_info_nce_averages_both_directions():
    """Sounds alike, motions apart: motions cannot be told by sound, and the loss is not that of one direction."""
    sounds, motions = torch.tensor([[1.0, 0], [1.0, 0]]), torch.eye(2)
    similar = sounds @ motions.T
    forth = -similar.log_softmax(1).diag().mean()
    back = -similar.T.log_softmax(1).diag().mean()
    loss = info_nce(sounds, motions, torch.tensor(1.0), torch.tensor([0, 1]))
    assert forth != back
    assert loss.item() == pytest.approx((0.5 * (forth + back)).item())


def test_embeddings_have_unit_length_and_depend_on_order():
    one = model()
    sound, motion = torch.randint(16, (2, 60, 2)), torch.randint(8, (2, 6, 3, 2))
    for found, turned in (
        (one.embed_audio(sound), one.embed_audio(sound.flip(1))),
        (one.embed_motion(motion), one.embed_motion(motion.flip(1))),
    ):
        torch.testing.assert_close(found.norm(dim=1), torch.ones(2))
        assert (found - turned).abs().max() > 1e-3


def test_slices_of_time_stay_apart():
    """What happens late in a clip does not reach the part of the embedding that stands for its beginning."""
    one = model()
    one.motion = torch.nn.Identity()
    codes = torch.zeros(1, 30, 3, 2, dtype=torch.int64)
    late = codes.clone()
    late[:, 20:] = 5
    found, other = (one.embed_motion(motion).view(5, 24).T for motion in (codes, late))
    found, other = found / found[0].norm(), other / other[0].norm()
    torch.testing.assert_close(found[:16], other[:16])
    assert (found[16:] - other[16:]).abs().max() > 1e-3
    assert one.embed_motion(codes[:, :10]).shape == (1, 8 * 5)


def test_the_whole_clip_is_one_embedding_in_the_papers_form():
    """LayerNorm behind the projection of the mean; positions by sinusoids alone, so without them order is lost."""
    torch.manual_seed(0)
    sizes = {"width": 16, "layers": 1, "heads": 2, "size": 12, "slices": 1}
    one = AudioMotion.from_codebooks(torch.randn(2, 16, 6), torch.randn(3, 2, 8, 4), **sizes).eval()
    motion = torch.randint(8, (2, 60, 3, 2))
    found = one.embed_motion(motion)
    assert found.shape == (2, 12)
    assert found.sum(1).abs().max() < 1e-5  # a LayerNorm has mean 0
    assert (found - one.embed_motion(motion.flip(1))).abs().max() > 1e-4
    read = torch.randn(1, 6, 12)
    plain, turned = (one.motion(one.motion_in(x)).mean(1) for x in (read, read.flip(1)))
    torch.testing.assert_close(plain, turned)
    assert one.embed_audio(torch.randint(16, (2, 60, 2))).sum(1).abs().max() < 1e-5


def test_a_size_that_slices_cannot_share_is_refused():
    with pytest.raises(ValueError, match=r"size \(100\) must be a multiple of slices \(24\)"):
        AudioMotionConfig(audio_encoder=AudioEncoderConfig(), motion_channels=1, size=100)


def test_files_and_reward(tmp_path):
    one = model()
    one.save(tmp_path / "a", {})
    again, motion = AudioMotion.load(tmp_path / "a"), torch.randint(8, (1, 6, 3, 2))
    torch.testing.assert_close(again.embed_motion(motion), one.embed_motion(motion))
    with pytest.raises(CheckpointError, match="is not a checkpoint"):
        AudioMotion.load(tmp_path / "none")
    made = scene(dips(()))
    heard, done = np.zeros((60, 2), np.int64), motion[0].numpy()
    object.__setattr__(made, "audio_codes", heard)
    object.__setattr__(made, "motion_codes", done)
    wanted = (one.embed_audio(torch.from_numpy(heard)[None]) * one.embed_motion(motion)).sum().item()
    assert one.judge(made, reference_statistics()) == pytest.approx(wanted, abs=1e-6)


def test_motion_is_read_as_features_where_the_paper_is_asked_for(tmp_path):
    """Appendix, Motion Encoder: m of N frames and D channels, one embedding for 4 s."""
    torch.manual_seed(0)
    mean, varies = torch.randn(315), torch.ones(315, dtype=torch.bool)
    statistics = FeatureStatistics(mean, torch.full((315,), 0.5), varies)
    books = torch.randn(2, 16, 6), torch.randn(3, 2, 8, 4)
    sizes = {"width": 16, "layers": 1, "heads": 2, "slices": 1}
    one = AudioMotion.from_codebooks(*books, statistics=statistics, **sizes).eval()
    motion = torch.randn(2, 120, 315)
    assert one.embed_motion(motion).shape == (2, 768)
    scaled = one.embed_motion(mean + (motion - mean) * 1.5)
    assert (scaled - one.embed_motion(motion)).abs().max() > 1e-3
    one.save(tmp_path, {})
    torch.testing.assert_close(AudioMotion.load(tmp_path).embed_motion(motion), one.embed_motion(motion))
    made = scene(dips(()))
    object.__setattr__(made, "audio_codes", np.zeros((300, 2), np.int64))
    object.__setattr__(made, "features", np.zeros((made.lead + 120, 315), np.float32))
    assert -1 <= one.judge(made, reference_statistics()) <= 1
