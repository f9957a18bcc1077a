"""The example study: its systems differ as they say, and it is filled and open."""

from importlib.resources import as_file, files

import numpy as np
import pytest
from studio.tests import canned

from echoavatar.models.audio import read_audio
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_studio.demo import PREFERENCES, SECONDS, SOUNDS, half_size, is_filled, make_demo
from echoavatar_studio.export import pairs
from echoavatar_studio.making import Maker
from echoavatar_studio.owner_actions import OwnerActions
from echoavatar_studio.results import results


def test_half_size_turns_half_as_far():
    motion = canned.moving(2.0, 1.0)
    halved, arm = half_size(motion), motion.skeleton.index("leftLowerArm")

    def swing(rotations: np.ndarray) -> float:
        return float(np.degrees(2 * np.arcsin(np.abs(rotations[:, arm, 2]).clip(0, 1))).max())

    whole = swing(motion.rotations)
    assert whole == pytest.approx(28.6, abs=1)
    assert swing(halved.rotations) == pytest.approx(whole / 2, abs=1.5)
    np.testing.assert_allclose(np.linalg.norm(halved.rotations, axis=-1), 1, atol=1e-5)


def test_speech_is_gesture_and_music_is_dance():
    assert {(file.split(".")[0].split("/")[0], kind) for _, file, kind, _ in SOUNDS} == {
        ("speech", "gesture"),
        ("music", "dance"),
    }


def test_every_sound_is_as_long_as_the_example_shows():
    """A study refuses sounds that are shorter."""
    for _, file, _, start in SOUNDS:
        with as_file(files("echoavatar") / "assets" / file) as path:
            assert len(read_audio(path)) >= (start + SECONDS) * SAMPLE_RATE_HZ, file


@pytest.mark.slow
def test_the_demo_is_filled_and_has_places_left(maker: Maker, tiny_bundle, tmp_path):
    assert not is_filled(maker.store)
    seen: list[tuple[int, int, str]] = []
    names = make_demo(maker, tmp_path / "library", model=str(tiny_bundle), progress=lambda *step: seen.append(step))
    assert {"loading the model", "animating speech 1", "raters answer"} <= {what for _, _, what in seen}
    assert all(0 <= done <= of for done, of, _ in seen)
    assert is_filled(maker.store)
    rows = {row.id: row for row in OwnerActions(maker, "test").studies().studies}
    assert [rows[name].state for name in names] == ["open", "open"]
    assert all(0 < rows[name].judgements < rows[name].judgements_wanted for name in names)
    assert all(rows[name].raters < rows[name].raters_wanted for name in names)
    found = results(maker.store, names[0])
    assert {row.system for row in found.rows} == set(PREFERENCES.worth)
    assert {row.category for row in found.rows} == {"dance", "gesture"}
    assert len(results(maker.store, names[1]).preferences) == 2
    assert len(pairs(maker.store, names[1])) >= 1
