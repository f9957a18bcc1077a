from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.evaluation import dial
from echoavatar_lab.evaluation.takes import Sound, Take

VOICES = [Sound(name, "speech", "", np.zeros(24_000, np.float32)) for name in ("a", "b")]
LIVELY = SimpleNamespace(has_manner=True)


def performer(calls):
    """In place of the avatar: sways as widely as the dial says."""

    def perform(pipeline, sounds, *, seed, options):
        calls.append((seed, options))
        size = 0.2 + 0.3 * (options.liveliness if options.liveliness is not None else 0.5)
        return [
            Take(sound.name, "speech", "", swaying(400, size=size * (1 + n / 10))) for n, sound in enumerate(sounds)
        ]

    return perform


def test_every_setting_is_performed_with_the_same_seeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list = []
    monkeypatch.setattr(dial, "perform", performer(calls))
    people = [Take(name, "speech", "", swaying(400, size=size)) for name, size in (("ann", 0.25), ("bob", 0.35))]
    settings = dial.turn_dials(LIVELY, [*VOICES, Sound("m", "music", "", VOICES[0].audio)], people, 30, seeds=[4, 5])
    assert [seed for seed, _ in calls] == [4, 5] * 12
    assert [options.liveliness for _, options in calls[:12:2]] == list(dial.SETTINGS)
    assert [options.handedness for _, options in calls[12::2]] == list(dial.SETTINGS)
    lively = [one for one in settings if one.dial == "liveliness"]
    assert all(np.diff([one.hand_speed for one in lively]) > 0)
    assert lively[0].interval.low < lively[0].hand_speed < lively[0].interval.high
    rows = dial.as_json(settings)
    assert rows["liveliness 0"]["outside"] > 0
    assert rows["liveliness 0.3"]["worst"] < rows["liveliness 1"]["worst"]
    assert 0.4 < rows["handedness 0.5"]["right_share"] < 0.6
    assert dial.as_text(settings).count("liveliness ") == 6
    dial.draw(settings, tmp_path / "dial.png")
    assert (tmp_path / "dial.png").stat().st_size > 5_000


def test_a_model_without_manners_and_music_alone_are_refused() -> None:
    with pytest.raises(EchoAvatarError, match="without manners"):
        dial.turn_dials(SimpleNamespace(has_manner=False), VOICES, [], 30)
    with pytest.raises(EchoAvatarError, match="have none"):
        dial.turn_dials(LIVELY, [Sound("m", "music", "", VOICES[0].audio)], [], 30)
