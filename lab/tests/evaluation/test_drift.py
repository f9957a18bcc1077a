import json
from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.test_takes import write_sound
from tests.motion.kinematics.samples import swaying

from echoavatar.cli import main
from echoavatar.errors import EchoAvatarError
from echoavatar.motion.kinematics import Motion
from echoavatar_lab.evaluation.drift import drifts, is_sure, minute, repeated
from echoavatar_lab.evaluation.metrics.tells import TELLS
from echoavatar_lab.evaluation.takes import Sound, Take

MINUTE_S = 12.0  # a short one


def take(name: str, sizes: tuple[float, ...]) -> Take:
    """A minute of each size, one after another."""
    parts = [swaying(int(MINUTE_S * 30), size=size) for size in sizes]
    rotations, root = (np.concatenate([getattr(part, key) for part in parts]) for key in ("rotations", "root"))
    return Take(name, "speech", "", Motion(parts[0].skeleton, rotations, root, 30.0))


def test_every_minute_hears_the_same() -> None:
    sound = Sound("a", "speech", "", np.arange(24_000 * 5, dtype=np.float32))
    (long,) = repeated([sound], 3, MINUTE_S)
    minutes = long.audio.reshape(3, -1)
    assert minutes.shape[1] == 24_000 * MINUTE_S
    assert (minutes == minutes[0]).all()
    assert (minutes[0, : 24_000 * 5] == sound.audio).all()
    with pytest.raises(EchoAvatarError, match="two minutes"):
        repeated([sound], 1)


def test_a_minute_is_cut_with_its_sound() -> None:
    whole = take("a", (0.1, 0.2))._replace(audio=np.arange(24_000 * 24, dtype=np.float32))
    last = minute(whole, 2, MINUTE_S)
    assert last.motion.frames == 360
    assert last.audio is not None
    assert last.audio[0] == 24_000 * MINUTE_S
    assert (last.motion.rotations == whole.motion.rotations[360:]).all()


def test_a_body_that_calms_down_drifts_and_a_steady_one_does_not() -> None:
    sizes = (0.30, 0.34, 0.38)
    calming = drifts([take(str(n), (size, size, size / 3)) for n, size in enumerate(sizes)], (1, 3), 12, minute_s=12)
    row = {one.name: one for one in calming["speech"]}["hand_speed"]
    assert row.later < row.earlier
    assert row.change == pytest.approx(row.later - row.earlier)
    assert is_sure(row)
    assert row.interval.low <= row.change <= row.interval.high < 0
    steady = drifts([take(str(n), (size,) * 3) for n, size in enumerate(sizes)], (1, 3), 12, minute_s=12)
    assert all(one.change == pytest.approx(0, abs=1e-6) for one in steady["speech"] if np.isfinite(one.change))


def test_performances_of_one_sound_count_once() -> None:
    several = drifts([take("a", (0.2, 0.3)), take("a", (0.2, 0.1))], (1, 2), 12, minute_s=12)["speech"]
    assert all(np.isnan(row.interval.low) for row in several)


def test_the_command_ends_with_json(tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["evaluate", str(tiny_bundle), "drift", "--minutes", "2", "--minute", "4", "--seconds", "4"]
    assert main(asked) == 1
    assert "--recordings" in capsys.readouterr().err
    write_sound(tmp_path / "voice.wav", 5)
    assert main([*asked, "--recordings", str(tmp_path)]) == 0
    rows = json.loads(capsys.readouterr().out.splitlines()[-1])["speech"]["rows"]
    assert {"hand_speed", "jerk"} <= set(rows)
    assert len(set(TELLS) & set(rows)) > 10  # the jury's, as far as a random body has them
    assert len(rows["hand_speed"]) == 5
