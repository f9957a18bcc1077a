import torch

from echoavatar.evaluation.post_bench import bench_post, restless
from echoavatar.ik import penetration_depth_m
from echoavatar.kinematics import HUMANOID
from echoavatar.kinematics.features import from_features
from echoavatar.pipeline.post import POST_STAGES


def test_every_stage_is_timed_alone_and_together() -> None:
    report = bench_post(chunks=24, sessions=4)
    for rows in (report.one_ms, report.many_ms):
        assert set(POST_STAGES) < set(rows)
        parts = sum(rows[stage][0] for stage in POST_STAGES)
        assert 0.3 < parts / rows["all"][0] < 3  # a chunk of each in turn
    assert report.summary["sessions"] == 4
    assert report.summary["batch_over_one"] < 4  # a batch is cheaper than its sessions one by one
    assert 0 < report.summary["post_wall_ms_least"] <= report.summary["post_wall_ms_p50"]


def test_the_motion_gives_every_stage_work() -> None:
    frames = from_features(HUMANOID, restless(240))
    depth = penetration_depth_m(HUMANOID, frames.rotations)
    assert (depth > 0.005).float().mean() > 0.01
    assert torch.diff(frames.rotations, n=3, dim=0).abs().mean() > 0.05
