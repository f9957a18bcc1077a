from echoavatar.evaluation.face_bench import bench_face, multiplications
from echoavatar.face import FaceConfig, FaceModel, MelConfig

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
    assert 0.3 < report["face_rtf"] * (1000 * 8 / 30) / report["face_ms_p50"] < 3
    assert report["sessions"] == 4
    assert abs(report["batch_over_one"] - report["batch_ms_p50"] / report["face_ms_p50"]) < 0.01
    assert 0 < report["batch_wall_ms_least"] <= report["batch_wall_ms_p50"]
    assert 0 < report["batch_floor_ms"] < report["batch_ms_p50"]


def test_multiplications_are_counted_by_hand():
    """Eight frames, two branches, three steps; what both branches share counts once."""
    shared = 52 * 16 + 3 * 52 * 4
    backbone = 16 * 48 + 16 * 16 + 2 * 16 * 64 + 16 * 8 + 8 * 4
    steps = 3 * (4 * 12 + 2 * 4 * 16 + 4 * 52)
    ear = 8 * 8 + 2 * 8 * 16 + 8 * 16
    assert multiplications(FaceModel(TINY)) == 8 * (shared + 2 * (backbone + steps) + ear)
