"""Clips as pages load them, and clips corrupted on purpose."""

import numpy as np
import soundfile
from studio.tests import canned

from echoavatar_studio.clips import Performance, corrupt, fit, load_clip, save_clip, save_sound


def test_a_clip_comes_back_as_the_live_protocol_packs_it(tmp_path):
    motion = canned.moving(1.0, 1.0)
    face = np.linspace(0, 1, 30 * 52, dtype=np.float32).reshape(30, 52)
    save_clip(tmp_path / "a.motion", Performance(motion, face))
    back = load_clip(tmp_path / "a.motion")
    assert np.abs((back.rotations * motion.rotations).sum(-1)).min() > 1 - 1e-7
    np.testing.assert_allclose(back.root, motion.root, atol=1e-6)
    np.testing.assert_allclose(back.face, face, atol=1 / 255)
    save_clip(tmp_path / "b.motion", Performance(motion))
    assert load_clip(tmp_path / "b.motion").face is None


def test_sound_is_kept_to_the_sample(tmp_path):
    audio = canned.hum(1.0, 220)
    save_sound(tmp_path / "a.flac", audio)
    samples, rate = soundfile.read(tmp_path / "a.flac", dtype="float32")
    assert rate == 24_000
    np.testing.assert_allclose(samples, audio, atol=1 / 32_000)
    assert len(fit(audio, 20)) == 16_000
    assert fit(audio, 40)[24_000:].max() == 0


def test_corrupted_motion_cannot_be_missed():
    """The arms turn by more than a thousand degrees a second, where people reach some hundreds."""
    good = Performance(canned.moving(2.0, 1.0))
    bad = corrupt(good, 0)
    arm = bad.motion.skeleton.index("leftUpperArm")

    def speed(shown: Performance) -> float:
        turns = shown.motion.rotations[:, arm]
        cosines = np.abs((turns[1:] * turns[:-1]).sum(-1)).clip(0, 1)
        return float(np.degrees(2 * np.arccos(cosines)).mean() * 30)

    assert speed(good) < 200
    assert speed(bad) > 1000
    np.testing.assert_allclose(np.linalg.norm(bad.motion.rotations, axis=-1), 1, atol=1e-5)
    assert np.array_equal(corrupt(good, 0).motion.rotations, bad.motion.rotations)
