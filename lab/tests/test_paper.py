"""Every field of what `reproduce --scale paper` builds, against `paper_fields.csv`, typed from the paper.

A row has the field, its value and the place in the paper, or "not given" and whose value it is. A field that no row
knows fails, and so does a row that no field has.
"""

import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from echoavatar.config import Config
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.errors import EchoAvatarError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.align.audio_encoders import Beats, BeatsConfig
from echoavatar_lab.align.start import AlignmentSetup
from echoavatar_lab.data.feature_statistics import FeatureStatistics
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.tokenizer.train import body_config
from echoavatar_lab.tables import alignment, latency, main
from echoavatar_lab.tables.experiment import Experiment, Sources
from echoavatar_lab.tables.scale import OURS, PAPER, GeneratorChoice

FIELDS = Path(__file__).parent / "recipes/paper_fields.csv"
FILLED = "layout"  # follows from codec and tokenizer


def test_every_field_of_the_papers_scale_is_in_the_table(tmp_path: Path) -> None:
    with FIELDS.open(encoding="utf-8", newline="") as file:
        rows = {row["field"]: row for row in csv.DictReader(file)}
    built = flat(built_at_the_papers_scale(tmp_path))
    assert sorted(built.keys() - rows.keys()) == [], "the table does not know these fields"
    assert sorted(rows.keys() - built.keys()) == [], "nothing has these fields"
    wrong = {name: (value, rows[name]["value"]) for name, value in built.items() if value != rows[name]["value"]}
    assert wrong == {}
    places = re.compile(
        r"(Settings|Motion Tokenizer|Audio Driven|Hierarchical|Example Control|Reward-Guided|Self-Supervised|Direct"
        r"|Audio-Motion|RL Alignment Corpus|Real-time|Online|appendix|not given: (ours|the release|MECo|published)).*"
    )
    assert [name for name, row in rows.items() if not places.fullmatch(row["where"])] == []


def built_at_the_papers_scale(folder: Path) -> dict[str, Any]:
    """What the tables would train with: the configs that their own functions make, on small stand-ins for weights."""
    published = Beats(BeatsConfig())
    experiment = Experiment(folder, PAPER, Sources(beats=folder / "beats.pt"))
    sizes = latency.paper_sizes()
    tokenizer = SimpleNamespace(
        codebooks=lambda: torch.zeros(3, 6, 512, 512),
        statistics=FeatureStatistics(torch.zeros(315), torch.ones(315), torch.ones(315, dtype=torch.bool)),
    )
    experiment.__dict__ |= {
        "corpus": SimpleNamespace(can_mirror=True, skeleton=HUMANOID),
        "codec": AudioCodec(sizes.codec),
        "tokenizer": lambda choice: tokenizer,
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("echoavatar_lab.align.audio_reward_train.read_tensors", lambda path, key: published.state_dict())
        model, alignment_training = alignment.alignment_settings(experiment)
    body = body_config(HUMANOID, PAPER.tokenizer)
    parts = [part.model_dump(exclude={"features"}) for part in body.parts.values()]
    assert list(body.parts) == ["lower", "upper", "hands"]
    assert parts[0] == parts[1] == parts[2]
    second = GeneratorChoice(OURS.name)
    stages = {1: second.before, 2: second, 3: main.directed(PAPER)}
    made = {stage: experiment.generator_settings(choice, body) for stage, choice in stages.items()}
    assert [choice.stage for choice in stages.values()] == [1, 2, 3]
    quality, quality_training = alignment.quality_settings(experiment, 315)
    found = {
        "tokenizer": parts[0],
        "tokenizer training": experiment.tokenizer_training(OURS),
        "tokens": experiment.token_settings(),
        "quality": quality,
        "quality training": quality_training,
        "alignment": model.config,
        "alignment training": alignment_training,
        "rewards": alignment.REWARDS,
        "sounds": {"hours": PAPER.speech_hours, "pieces": PAPER.pieces, "pairs": PAPER.pairs},
        "latency codec": sizes.codec,
        "latency face": sizes.face,
        "latency runtime": Runtime(level_control=False).chosen("paper"),
    }
    for stage, (config, training) in made.items():
        found |= {f"stage {stage}": config, f"stage {stage} training": training}
        assert config.layout.motion_layers == 6
    for method in alignment.LINES:
        found[method] = alignment._training(experiment, method)
    assert sizes.tokenizer == body
    assert sizes.generator == made[2][0]
    return found


def flat(found: Any, name: str = "") -> dict[str, str]:
    """Values as JSON by dotted names."""
    if isinstance(found, Config):
        found = found.model_dump(mode="json")
    if not isinstance(found, dict):
        rounded = [round(one, 4) for one in found] if isinstance(found, list) else found
        return {name: json.dumps(rounded)}
    return {
        key: value
        for own, one in found.items()
        if own != FILLED
        for key, value in flat(one, f"{name}.{own}" if name else str(own)).items()
    }


def test_prompts_are_the_sounds_of_the_rl_corpus_and_not_the_clips(tmp_path: Path, monkeypatch) -> None:
    """The generator is tuned on sounds without motion, and measured on held-out clips."""
    train_clips, test_clips, sounds = {"clip": 1}, {"held": 2}, {"sound": 3}
    experiment = SimpleNamespace(
        generator=lambda choice: torch.nn.Linear(1, 1),
        tokenizer=lambda choice: None,
        corpus=SimpleNamespace(folder=tmp_path),
    )
    reward = SimpleNamespace(judge=lambda motion, statistics: 0.0)
    monkeypatch.setattr(alignment, "token_clips", lambda experiment: (train_clips, test_clips))
    monkeypatch.setattr(alignment, "_quality", lambda experiment, clips: reward if clips is train_clips else None)
    monkeypatch.setattr(
        alignment, "alignment_reward", lambda experiment, clips: reward if clips is train_clips else None
    )
    monkeypatch.setattr(alignment, "_prompt_clips", lambda experiment, generator: sounds)
    ready: AlignmentSetup = alignment._setting(experiment)
    assert (ready.train, ready.test) == (sounds, test_clips)


def test_the_papers_scale_wants_the_published_beats(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="BEATs_iter3_plus_AS2M.pt as --beats"):
        alignment.alignment_reward(Experiment(tmp_path, PAPER), {})
