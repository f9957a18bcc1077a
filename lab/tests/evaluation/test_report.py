from pathlib import Path

import numpy as np
import pytest

from echoavatar.engine.pipeline import load_bundle
from echoavatar.timing import CHUNK_SAMPLES
from echoavatar_lab.corpora.rehearsal.corpus import Plan, make_clip
from echoavatar_lab.evaluation.behaviour import MUSIC, SPEECH
from echoavatar_lab.evaluation.report import Recording, evaluate

pytest.importorskip("librosa", reason="the evaluate extra is not installed")
PROMISED = {
    "mpjpe_body_mm",
    "mpjpe_hands_mm",
    "root_velocity_mm",
    "nll_gain_speech",
    "nll_gain_music",
    "leg_energy_music_over_speech",
    "silence_hand_speed_ratio",
    "ba_onset",
    "ba_onset_chance",
    "ba_beat",
    "ba_beat_chance",
    "skate_cm_s",
    "jerk_ratio",
    "max_joint_deg_s",
}


def test_every_promised_score_is_there_and_the_truth_scores_as_truth(tiny_bundle: Path, voice: np.ndarray) -> None:
    """Three made clips and two recordings through a bundle of random weights."""
    clips = [make_clip(Plan(1.0, 47, Path("unused"), clip_seconds=20.0), index) for index in (0, 1, 2)]
    recordings = [Recording("a", SPEECH, np.resize(voice, 72_000)), Recording("b", MUSIC, np.resize(voice, 72_000))]
    told: dict[str, int] = {}
    scores = evaluate(
        load_bundle(tiny_bundle),
        clips,
        recordings,
        repeats=2,
        progress=lambda what, done, total: told.update({what: total}),
    )
    assert scores.keys() >= PROMISED
    chunks = sum(-(-len(clip.audio) // CHUNK_SAMPLES) for clip in clips)
    assert told == {"held-out clips": 2 * chunks, "recordings": 2 * -(-72_000 // CHUNK_SAMPLES)}
    assert abs(scores["nll_all"] - np.log(8)) < 0.5  # random weights know nothing: ln K
    assert scores["ba_beat_truth"] > scores["ba_beat_chance_truth"]
    assert scores["skate_cm_s_truth"] < 1
    assert scores["leg_energy_music_over_speech_truth"] > 4
