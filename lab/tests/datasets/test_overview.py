import numpy as np
import pytest
from lab.tests.datasets.samples import gesture, motorica_names, renamed, write_motion, write_pair
from PIL import Image

from echoavatar_lab.datasets.layouts import survey_of
from echoavatar_lab.datasets.overview import _spread, _wrists, draw_overview
from echoavatar_lab.datasets.prepare_dataset import prepare
from echoavatar_lab.datasets.source import SetOptions


def drawn(folder, rig: str, sheets: int) -> list:
    write_pair(folder / "takes" / "a.bvh", 1.0)
    write_motion(folder / "takes" / "b.bvh", renamed(gesture(1.0), motorica_names()))
    options = SetOptions(fingers="keep", sound="any", rig=rig)
    corpus = prepare("bvh", survey_of("bvh", folder / "takes"), folder / "set", options).corpus
    return draw_overview(corpus, folder / "pictures", sheets=sheets)


def test_histograms_of_a_set_are_drawn(tmp_path):
    written = drawn(tmp_path, "unified", 0)
    assert [path.name for path in written] == ["duration.png", "speed.png", "pose.png"]
    for path in written:
        pixels = np.asarray(Image.open(path).convert("L"))
        assert pixels.shape[1] > 600
        assert pixels.std() > 10


@pytest.mark.slow
def test_contact_sheets_of_native_rigs_are_drawn(tmp_path):
    pixels = np.asarray(Image.open(drawn(tmp_path, "native", 1)[-1]))
    assert pixels.shape == (440, 1500, 3)


def test_wrists_are_seen_from_where_the_hips_face():
    """A figure that faces backwards gives the same picture."""
    motion = gesture(1.0)
    rotations = motion.rotations.copy()
    w, x, y, z = rotations[:, 0].T
    rotations[:, 0] = np.stack([-y, z, w, -x], 1)  # half a turn about Y before it
    turned = type(motion)(motion.skeleton, rotations, motion.root, motion.fps)
    np.testing.assert_allclose(_wrists(turned), _wrists(motion), atol=1e-5)


def test_names_are_spread_over_the_set():
    assert _spread(list("abcdefg"), 3) == ["a", "d", "g"]
    assert _spread(["a"], 3) == ["a"]
