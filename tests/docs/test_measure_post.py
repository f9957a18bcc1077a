"""The script that measures the stages behind the decoder steps as the default bundle does."""

from pathlib import Path

import pytest
from scripts import measure_post

from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.motion.stages.post import SWITCHES

SPEECH = Path(__file__).parents[2] / "src/echoavatar/assets/speech.ogg"


def test_what_the_default_bundle_makes_is_measured_in_its_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure_post, "SECONDS", 2.0)
    features = measure_post.generate([SPEECH])
    assert features.shape[:2] == (1, 60)
    shown = measure_post.through(features, SWITCHES, MotionOptions(), 4)
    assert measure_post.measured(*shown, 4)["frames"] == 60
