import numpy as np

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.features import from_features
from echoavatar.motion.stages.post import POST_STAGES
from echoavatar_lab.bench.post import bench_post, restless
from echoavatar_lab.data.faults import penetration_depth_m


def test_every_stage_is_timed_for_one_session_and_for_many() -> None:
    report = bench_post(chunks=24, sessions=4)
    for stages in (report.one_ms, report.many_ms):
        assert set(stages) == {*POST_STAGES, "all"}
        assert all(0 <= stages[stage] <= stages["all"] for stage in POST_STAGES)  # medians: no part above the whole
    assert report.summary == {"post_ms": report.one_ms["all"], "sessions": 4, "ms_per_session": report.many_ms["all"]}


def test_the_motion_gives_every_stage_work() -> None:
    frames = from_features(HUMANOID, restless(240))
    depth = penetration_depth_m(HUMANOID, frames.rotations)
    assert (depth > 0.005).mean() > 0.01
    assert np.abs(np.diff(frames.rotations, n=3, axis=0)).mean() > 0.05
