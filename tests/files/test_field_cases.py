"""The cases from the field beside a checkout (`../shared/cases/field`): each is read as its README says.

Every kind of them also has a test of its own, with files made for it, that runs everywhere.
"""

from pathlib import Path

import numpy as np
import pytest

from echoavatar.cli import main
from echoavatar.files.exports import read_take
from echoavatar.models.audio import read_audio
from echoavatar.timing import SAMPLE_RATE_HZ

FIELD = Path(__file__).parents[3] / "shared/cases/field"
pytestmark = pytest.mark.skipif(not FIELD.is_dir(), reason="needs ../shared/cases/field")


def case(name: str) -> Path:
    (path,) = FIELD.glob(f"*/{name}")
    return path


def heights(name: str) -> tuple[float, float]:
    """How far the head is above the hips, and the lower foot below them, metres."""
    motion = read_take(case(name)).motion
    places, index = motion.pose().positions[0, :, 1], motion.skeleton.index
    hips = places[index("hips")]
    return float(places[index("head")] - hips), float(hips - min(places[index("leftFoot")], places[index("rightFoot")]))


@pytest.mark.parametrize("name", ["cat_rate.mp3", "cat_mono_stereo.mp3", "cat_aac.aac"])
def test_pasted_sounds_are_read_to_their_end(name: str) -> None:
    assert len(read_audio(case(name))) / SAMPLE_RATE_HZ == pytest.approx(12.0, abs=0.2)


def test_a_frame_more_than_the_header_says_is_read_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    assert read_take(case("rokoko_count.bvh")).motion.frames == 180
    assert "180" in caplog.text


def test_the_rate_of_television_is_kept() -> None:
    assert read_take(case("ntsc2997.bvh")).motion.fps == pytest.approx(30_000 / 1001, abs=1e-4)


@pytest.mark.parametrize("name", ["sjis.bvh", "brace_same.bvh"])
def test_other_encodings_and_lines_are_read(name: str) -> None:
    head, legs = heights(name)
    assert 0.4 < head < 0.9
    assert 0.6 < legs < 1.1


def test_a_clip_whose_up_is_z_stands_and_one_in_metres_is_a_person() -> None:
    for name in ("rest_zup.bvh", "rest_metres.bvh"):
        head, legs = heights(name)
        assert 0.4 < head < 0.9
        assert 0.6 < legs < 1.1


def test_a_bad_file_of_two_stops_no_other(tmp_path: Path, tiny_bundle: Path) -> None:
    sounds = [str(case(name)) for name in ("html.wav", "mulaw8k.wav")]
    assert main(["animate", *sounds, "-o", str(tmp_path), "--format", ".npz", "--model", str(tiny_bundle)]) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["mulaw8k.npz"]
    with np.load(tmp_path / "mulaw8k.npz", allow_pickle=False) as made:
        assert all(np.isfinite(made[key]).all() for key in made.files if made[key].dtype.kind == "f")
