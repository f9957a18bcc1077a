import pytest
from lab.tests.datasets.samples import SHARED, gesture, write_motion

from echoavatar_lab.datasets.bandai import survey


def test_content_and_style_are_read_from_the_name(tmp_path):
    write_motion(tmp_path / "dataset-2" / "dataset-2_raise-up-both-hands_not-confident_004.bvh", gesture(0.5))
    write_motion(tmp_path / "dataset-2" / "odd.bvh", gesture(0.5))
    found = survey(tmp_path)
    assert [dict(one.labels) for one in found.recordings] == [
        {"part": "dataset-2", "content": "raise-up-both-hands", "style": "not-confident"}
    ]
    assert found.recordings[0].sound is None
    assert found.missing == ["dataset-1 is not there"]
    assert [name for name, _ in found.left_out] == ["odd"]


@pytest.mark.skipif(
    not SHARED.exists(), reason="needs ../shared/data, which only a checkout with the authors' recordings has"
)
def test_the_real_subset_is_found_completely():
    found = survey(SHARED / "bandai_namco_cc_by_nc")
    assert len(found.recordings) == 190
    assert not found.left_out
    assert not found.missing
    assert len({one.labels["style"] for one in found.recordings}) == 19
