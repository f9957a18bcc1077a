from echoavatar.evaluation.face_bench import CHUNK_MS, bench_face
from echoavatar.face import FaceConfig, FaceModel, MelConfig


def test_times_of_one_and_of_a_batch_fit_together():
    tiny = FaceModel(FaceConfig(encoder=MelConfig(bands=8, width=8, blocks=1), width=16, heads=2, layers=1))
    report = bench_face(tiny, chunks=10, sessions=4)
    assert report["face_ms_p99"] >= report["face_ms_p50"] > 0
    assert 0.3 < report["face_rtf"] * CHUNK_MS / report["face_ms_p50"] < 3
    assert report["sessions"] == 4
