"""Hands that are fastest a tenth of a second before each stress are found to be; others are not."""

import numpy as np
import pytest

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_lab.corpora.rehearsal.recording_labels import track_from_recording
from echoavatar_lab.evaluation.strokes import as_json, as_text, responses
from echoavatar_lab.evaluation.takes import Take

SECONDS = 40


@pytest.fixture(scope="module")
def voice() -> np.ndarray:
    """Syllables of a buzzing voice, now and then a louder and higher one."""
    random, time = np.random.default_rng(0), np.arange(SECONDS * SAMPLE_RATE_HZ) / SAMPLE_RATE_HZ
    sound, at = np.zeros(len(time)), 0.3
    while at < SECONDS - 1:
        is_stressed = random.random() < 0.25
        heard = slice(int((at - 0.3) * SAMPLE_RATE_HZ), int((at + 0.3) * SAMPLE_RATE_HZ))  # silence beyond
        envelope = np.exp(-(((time[heard] - at) / 0.06) ** 2)) * (1.0 if is_stressed else 0.3)
        pitch = 150 if is_stressed else 110
        sound[heard] += envelope * sum(np.sin(2 * np.pi * pitch * k * time[heard]) / k for k in range(1, 20))
        at += random.uniform(0.2, 0.35) + (0.8 if random.random() < 0.1 else 0)
    return (0.2 * sound / np.abs(sound).max()).astype(np.float32)


def take(voice: np.ndarray, times: np.ndarray, name: str = "a") -> Take:
    """Both forearms turn fast about these times, and slowly to and fro at others."""
    frames = np.arange(SECONDS * 30) / 30
    strokes = sum(np.exp(-(((frames - time) / 0.08) ** 2)) * (-1) ** k for k, time in enumerate(times))
    turns = np.zeros((len(frames), HUMANOID.joints, 3), np.float32)
    turns[:, HUMANOID.indices(("leftLowerArm", "rightLowerArm")), 1] = (
        np.cumsum(strokes)[:, None] * 0.1 + 0.1 * np.sin(3 * frames)[:, None]
    )
    root = np.tile(np.float32([0, 0.9, 0]), (len(frames), 1))
    return Take(name, "speech", "", Motion(HUMANOID, quaternion_from_axis_angle(turns), root, 30.0), voice)


def test_hands_before_a_stress_and_hands_at_any_time(voice: np.ndarray) -> None:
    stresses = np.array(track_from_recording(voice, "speech").stresses)
    assert len(stresses) > 10
    anywhere = np.random.default_rng(1).uniform(1, SECONDS - 1, len(stresses))
    found = responses([take(voice, stresses - 0.1)], [take(voice, anywhere), Take("b", "music", "", None, voice)])  # type: ignore[arg-type]
    assert found["ours"].fastest_s == pytest.approx(-0.1, abs=0.04)
    assert found["ours"].profile.max() > 3 * abs(found["people"].profile).max()
    assert f"at {found['ours'].fastest_s:+.2f} s" in as_text(found)
    assert as_json(found)["ours"]["stresses"] == found["ours"].stresses  # type: ignore[index]


def test_without_sound_there_is_nothing_to_say(voice: np.ndarray) -> None:
    silent = take(voice, np.zeros(0))._replace(audio=None)
    found = responses([silent], [])
    assert "ours: no speech with sound" in as_text(found)
    assert as_json(found) == {}
