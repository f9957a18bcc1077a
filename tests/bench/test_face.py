import pytest

from echoavatar.bench.face import bench_face
from echoavatar.models.face import FaceConfig, FaceModel, MelConfig

TINY = FaceConfig(
    encoder=MelConfig(bands=8, windows=1, width=8, blocks=1),
    width=16,
    heads=2,
    layers=1,
    condition=8,
    head_width=4,
    head_blocks=1,
)


def test_times_of_one_and_of_a_batch_fit_together():
    report = bench_face(FaceModel(TINY), chunks=10, sessions=4)
    assert report["face_ms_p99"] >= report["face_ms_p50"] > 0
    assert report["sessions"] == 4
    assert report["batch_over_one"] == pytest.approx(report["batch_ms_p50"] / report["face_ms_p50"], rel=0.01)
