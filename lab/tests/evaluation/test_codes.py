import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.models.generator.tiny import config, generator

from echoavatar.cli import main
from echoavatar.engine.pipeline import load_bundle
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle
from echoavatar.motion.stages.post import Post
from echoavatar_lab.commands import evaluate_measures
from echoavatar_lab.corpora.rehearsal.corpus import Plan, make_clip
from echoavatar_lab.data import MUSIC, SPEECH
from echoavatar_lab.evaluation.codes import (
    dance_turn_deg,
    drawn_after_truth,
    reliance,
    reliance_rows,
    reliance_table,
    replayed,
    sharing_in_speech,
    token_clips,
    true_codes,
)
from echoavatar_lab.evaluation.measures import Track
from echoavatar_lab.evaluation.metrics.tells import SHARING
from echoavatar_lab.models.generator.train import GeneratorTask, GeneratorTraining
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.training import Loop


def test_a_model_that_knows_nothing_loses_nothing_when_the_audio_is_exchanged(tiny_bundle: Path) -> None:
    bundle = load_bundle(tiny_bundle)
    clips = [make_clip(Plan(1.0, 44, Path("unused"), clip_seconds=16.0), index) for index in range(2)]
    tokens = token_clips(bundle, clips)
    scores = reliance(bundle.generator, tokens)
    assert abs(scores["all"].gain) < 0.1
    assert abs(scores["all"].timing_gain) < 0.1
    rows = {row.name: row for row in reliance_rows(scores)}
    assert rows["nll_all"].excess == rows["nll_all"].value - rows["nll_all"].chance
    assert rows["timing_gain_all"].value == scores["all"].timing_gain
    table = reliance_table({"a": bundle.generator, "b": bundle.generator}, tokens).splitlines()
    assert table[0].count("|") == table[1].count("|") == table[-1].count("|") == 10
    assert table[-1].startswith("| all |")


def test_timing_is_worth_something_to_a_model_that_moves_on_what_it_hears_now() -> None:
    """Motion that repeats its chunk's audio code is a surprise to the trained model where that audio comes late."""
    rng = np.random.default_rng(0)
    made = []
    for _ in range(12):
        key = rng.integers(8, size=16)
        motion = np.repeat(key, 2)[:, None, None] * np.ones((1, 3, 2), int)
        audio = np.repeat(key, 20)[:, None].repeat(2, 1)
        made.append(TokenClip(audio, motion, np.ones(32, np.uint8)))
    settings = GeneratorTraining(steps=60, batch=8, chunks=4, learning_rate=5e-3, warmup=5, depth_weights=(1.0, 0.5))
    loop = Loop(GeneratorTask(config(layers=1), settings, made))
    for _ in range(60):
        loop.advance()
    assert reliance(loop.stage.generator.eval(), made)["speech"].timing_gain > 0.3


class Perfect(BodyTokenizer):
    """Hands features through as they are."""

    def encode(self, features):
        self.kept = features
        return torch.zeros(1, len(features[0]) // 4, 3, 4, dtype=torch.int64)

    def decode(self, codes):
        return self.kept


def test_a_perfect_tokenizer_keeps_all_of_the_timing_and_one_of_random_weights_none(tiny_bundle: Path):
    clips = [make_clip(Plan(1.0, 47, Path("unused"), clip_seconds=32.0), index) for index in (0, 3, 5)]
    bundle, tokenizer = load_bundle(tiny_bundle), BodyTokenizer.load(tiny_bundle / "tokenizer")
    random = true_codes(bundle, clips, tokenizer=tokenizer)
    tokenizer.__class__ = Perfect
    found = true_codes(bundle, clips, tokenizer=tokenizer)
    # what is said, and so the length of the music, depends on the machine's speech engine; short music has no turn
    truth, lost = found["truth"], random["decoded"]
    assert found["decoded"] == pytest.approx(truth, rel=1e-3, abs=1e-3, nan_ok=True)
    assert truth["beat_excess"] > 0.2
    assert abs(lost["beat_excess"]) < 0.3 * truth["beat_excess"]
    assert lost["jerk_m_s3"] > 5 * truth["jerk_m_s3"]
    assert found["tokenizer"]["codes_mpjpe_body"] < 1e-3 < 10 < random["tokenizer"]["codes_mpjpe_body"]


def test_turn_counts_in_long_stretches_of_music_alone():
    """Shoulders turn by 5 degrees each way in 15 s of music, by 40 in speech and in a second of music."""
    domain = np.repeat([MUSIC, SPEECH, MUSIC], [450, 300, 30]).astype(np.uint8)
    turn = np.radians(np.where(np.arange(780) < 450, 5, 40) * np.resize([-1, 1], 780))
    places = np.zeros((780, HUMANOID.joints, 3))
    for side, sign in (("left", 1), ("right", -1)):
        places[:, HUMANOID.index(side + "UpperLeg"), 0] = 0.1 * sign
        places[:, HUMANOID.index(side + "UpperArm")] = 0.2 * sign * np.stack([np.cos(turn), 0 * turn, np.sin(turn)], 1)
    speeds = np.zeros((779, HUMANOID.joints))
    assert dance_turn_deg([Track(places, speeds, domain)]) == pytest.approx(5, abs=1e-3)
    assert np.isnan(dance_turn_deg([Track(places, speeds, np.full(780, SPEECH, np.uint8))]))


def test_hands_share_their_work_in_speech_alone():
    """In speech both hands rise together, in music one by one."""
    time = np.arange(900) / 30
    domain = np.repeat([SPEECH, MUSIC], 450).astype(np.uint8)
    places = np.repeat(HUMANOID.rest_positions[None], 900, 0)
    for side, speed in (("left", 1.0), ("right", np.where(domain == SPEECH, 1.0, 1.3))):
        places[:, HUMANOID.index(side + "Hand"), 1] += 0.1 * np.sin(2 * np.pi * speed * time)
    speeds = np.zeros((899, HUMANOID.joints))
    found = sharing_in_speech([Track(places, speeds, domain)])
    assert found["hands: heights together"] == pytest.approx(1)
    assert sharing_in_speech([Track(places, speeds, domain[::-1].copy())])["hands: heights together"] < 0.5
    assert np.isnan(list(sharing_in_speech([Track(places[:250], speeds, domain[:250])]).values())).all()


def test_a_replayed_body_talks_where_its_legs_do_not_dance(voice):
    """An arm swings alone, then with legs that dance, which a session notices within seconds."""
    frames, post = 240, Post(HUMANOID)
    swing = np.sin(2 * np.pi * np.arange(frames) / 30)
    audio = np.resize(voice, frames * 800)

    def moved(joints):
        turns = np.zeros((frames, HUMANOID.joints, 3), np.float32)
        turns[:, HUMANOID.indices(joints), 0] = swing[:, None]
        root = np.tile(HUMANOID.offsets[:1], (frames, 1))
        return Motion(HUMANOID, quaternion_from_axis_angle(turns), root, 30.0)

    arms, legs = ("leftUpperArm", "leftLowerArm"), ("leftUpperLeg", "rightUpperLeg", "leftLowerLeg", "rightLowerLeg")
    talks, dances = moved(arms), moved(arms + legs)
    apart = {}
    for name, motion in (("talks", talks), ("dances", dances)):
        plain, spoken = replayed(post, motion), replayed(post, motion, audio)
        apart[name] = np.abs(plain.rotations - spoken.rotations)[-60:].max()
    assert apart["talks"] > 0.02
    assert apart["dances"] < 1e-3


@pytest.mark.parametrize("sequence", ["interleaved", "prefix", "depth"])
def test_a_chunk_is_drawn_after_the_true_past_alone(sequence):
    model, rng = generator(sequence=sequence, temperature=0.1), np.random.default_rng(3)
    audio, motion = rng.integers(0, 16, (80, 2)), rng.integers(0, 8, (8, 3, 2))
    clip = TokenClip(audio, motion, np.zeros(8, np.uint8))
    drawn = drawn_after_truth(model, clip)
    assert drawn.shape == motion.shape
    differs = []
    for chunk in range(4):
        other = motion.copy()
        other[2 * chunk : 2 * chunk + 2] = 0
        changed = drawn_after_truth(model, TokenClip(audio, other, clip.domain))
        assert torch.equal(changed[: 2 * chunk + 2], drawn[: 2 * chunk + 2])
        differs.append(not torch.equal(changed, drawn))
    assert any(differs)


def test_the_command_ends_with_json(
    tiny_bundle: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluate_measures, "Plan", partial(Plan, clip_seconds=16.0))
    folder = str(tiny_bundle)
    assert main(["evaluate", folder, "codes", "--clips", "1"]) == 0
    rows = {"tokenizer", "truth", "decoded", "shown", "drawn", "performed"}
    said = capsys.readouterr().out.splitlines()
    assert json.loads(said[-1]).keys() == rows
    assert [line.split()[0] for line in said[3:5]] == ["onset_excess*", "beat_excess*"]
    assert {*SHARING} <= json.loads(said[-1])["performed"].keys()
    assert main(["evaluate", folder, "codes", "--clips", "1", "--tokenizer", f"{folder}/tokenizer"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1]).keys() == rows - {"drawn", "performed"}
