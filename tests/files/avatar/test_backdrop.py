import runpy
from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.files.avatar.backdrop import BACKDROPS, Backdrop, tone_curve

ROOT = Path(__file__).parents[3]


def test_the_pages_have_the_same_light_and_backdrops() -> None:
    """After a change of backdrop.py: python scripts/make_stages.py && make web."""
    made = runpy.run_path(str(ROOT / "scripts" / "make_stages.py"))
    assert made["TARGET"].read_text("utf-8") == made["text"]()


def test_a_colour_is_exact_everywhere_so_that_it_can_be_keyed() -> None:
    np.testing.assert_array_equal(Backdrop.of("#00ff10").picture(32, 16), np.tile([0, 255, 16], (16, 32, 1)))


@pytest.mark.parametrize("name", BACKDROPS)
def test_named_stages_have_no_hard_edge(name: str) -> None:
    picture = Backdrop.of(name).picture(64, 360).astype(int)
    assert np.abs(np.diff(picture, axis=0)).max() <= 6


def test_another_background_is_refused_with_the_choices() -> None:
    with pytest.raises(MotionError, match="studio"):
        Backdrop.of("beach")


def test_the_tone_curve_rises_from_black_to_white() -> None:
    curve = tone_curve().astype(int)
    assert curve[0] == 0
    assert curve[-1] > 250
    assert (np.diff(curve) >= 0).all()
