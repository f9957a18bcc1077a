"""An experiment of four swaying clips that trains nothing: whatever is made is the truth, turned down."""

from dataclasses import replace

import numpy as np
import torch
from lab.tests.evaluation.clips import MUSIC, SPEECH, clip
from tests.models.generator.tiny import generator

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.evaluation.table import Interval, Row
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.tables.experiment import Experiment, Sources
from echoavatar_lab.tables.scale import TINY


class FakeExtractor:
    """An extractor: latents are a few of the features, one every eight frames."""

    def features(self, clip: torch.Tensor) -> torch.Tensor:
        return clip[: len(clip) // 8 * 8 : 8, :316:40]


def counted(motions, clips, extractor, *, seed: int = 0) -> list[Row]:
    """Scores in no time: FID is how far the roots are from the truth, the rest how many clips there were."""
    off = sum(float(abs(m.root - c.root).mean()) for m, c in zip(motions, clips, strict=True))
    names = ("l1_diversity", "ba_g_paper", "ba_d_paper")
    rows = [Row("fid", "", off, Interval(off, off), truth=1.0)]
    return rows + [Row(name, "", len(clips) / 10) for name in names]


class FakeExperiment:
    seed, scale, extractor, device = 0, TINY, FakeExtractor(), "cpu"
    runtime, rig, sources = "paper", HUMANOID, Sources()
    baseline_motions = Experiment.baseline_motions

    def __init__(self) -> None:
        self.said: list[str] = []
        self.asked: list[str] = []
        kinds = (SPEECH, MUSIC, SPEECH, MUSIC)
        self.test_clips = [
            clip(f"c{n}", 96, size=0.2 + 0.1 * n, every_s=0.4 + 0.05 * n, kind=kind) for n, kind in enumerate(kinds)
        ]
        self.train_clips = [replace(one, split="train") for one in self.test_clips]

    @property
    def true_motions(self):
        return [one.motion() for one in self.test_clips]

    def say(self, line: str) -> None:
        self.said.append(line)

    def foreign_motions(self):
        return {}

    def generator(self, choice):
        """A generator of random weights; one without corruption is deaf."""
        made = generator()
        if choice.name == "corruption-none":
            layout = made.config.layout
            made.model.embed_tokens.weight.data[layout.audio_base : layout.motion_base] = 1.0
        return made

    def codes(self, choice, clips):
        random = np.random.default_rng(0)
        return [
            TokenClip(
                random.integers(8, size=(20 * 3, 2)), random.integers(8, size=(2 * 3, 3, 2)), np.ones(6, np.uint8)
            )
            for _ in clips
        ]

    def generated_motions(self, choice):
        self.asked.append(choice.name)
        return self.true_motions
