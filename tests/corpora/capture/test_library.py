from pathlib import Path

import numpy as np
import pytest

from echoavatar.corpora.capture.library import CapturedLibrary, open_library, read_folder
from echoavatar.errors import MotionError


def test_takes_are_cut_named_and_start_at_the_origin(people: CapturedLibrary):
    assert [clip.name for clip in people.clips] == ["cleo", "anna", "ben.0", "ben.1"]
    assert {clip.kind for clip in people.clips} == {"speech", "standing"}
    assert people.credits() == {"standing": "MIT", "speech": "MIT"} or "standing" in people.credits()
    for clip in people.clips:
        assert np.linalg.norm(clip.controls.pelvis_position[0, [0, 2]]) < 0.05
        assert abs(clip.controls.pelvis_rotation[:15, 0].mean()) < 0.1
    cut = sum(clip.seconds for clip in people.clips if clip.name.startswith("ben"))
    assert 13.0 < cut < 13.6


def test_a_library_comes_back_as_it_was_saved(people: CapturedLibrary, tmp_path: Path):
    people.save(tmp_path / "people.npz")
    again = open_library(tmp_path / "people.npz")
    for one, other in zip(people.clips, again.clips, strict=True):
        assert (one.name, one.kind, one.group, one.source, one.licence) == (
            other.name,
            other.kind,
            other.group,
            other.source,
            other.licence,
        )
        np.testing.assert_array_equal(one.controls.packed(), other.controls.packed())


def test_what_may_not_train_is_left_out_and_errors_name_the_remedy(captured_folder: Path, tmp_path: Path):
    for path in captured_folder.rglob("*.bvh"):
        copy = tmp_path / path.relative_to(captured_folder)
        copy.parent.mkdir(exist_ok=True)
        copy.write_bytes(path.read_bytes())
    (tmp_path / "manifest.csv").write_text(
        "file,licence,use\nspeech/cleo.bvh,CC BY-NC,tests only\nstanding/anna.bvh,CC BY-NC,tests only\n"
    )
    assert {clip.name for clip in read_folder(tmp_path).clips} == {"ben"}
    with pytest.raises(MotionError, match="holds no captured set; put BVH files into folders"):
        read_folder(tmp_path / "nothing")
    with pytest.raises(MotionError, match="echoavatar data capture"):
        open_library(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(MotionError, match="damaged"):
        open_library(tmp_path / "bad.npz")
