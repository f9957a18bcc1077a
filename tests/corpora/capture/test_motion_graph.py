import numpy as np

from echoavatar.corpora.capture.library import CapturedLibrary
from echoavatar.corpora.capture.motion_graph import joined, poses_of, varied
from echoavatar.corpora.rehearsal.controls import ANKLE_HEIGHT, moved


def test_a_join_is_continuous_and_feet_do_not_slide(people: CapturedLibrary):
    before, after = (
        people.clips[1].controls[:150],
        moved(people.clips[2].controls[:150], np.array([3.0, 1.0]), turn=1.0),
    )
    both = joined(before, after)
    assert len(both) == 300
    assert np.abs(np.diff(both.pelvis_position, axis=0)).max() * 30 < 1.0
    assert np.abs(np.diff(both.spine, axis=0)).max() * 30 < 2.0
    slide = np.linalg.norm(np.diff(both.foot_position[..., [0, 2]], axis=0), axis=-1) * 30
    low = both.foot_position[..., 1] < ANKLE_HEIGHT + 0.001
    assert slide[low[1:] & low[:-1]].max() < 0.15
    assert np.linalg.norm(both.pelvis_position[-1, [0, 2]]) < 1.0


def test_poses_are_near_for_the_same_pose_elsewhere(people: CapturedLibrary):
    clip = people.clips[1].controls
    elsewhere = poses_of(moved(clip, np.array([2.0, -1.0]), turn=0.7))
    own = poses_of(clip)
    assert np.abs(elsewhere - own).max() < 1e-3
    assert np.linalg.norm(own[100] - poses_of(people.clips[0].controls)[100]) > 0.05


def test_sizes_scale_sway_and_lean(people: CapturedLibrary):
    clip = people.clips[0].controls
    large = varied(clip, sway=1.5, lean=1.5, turn=1.5)
    assert large.spine[:, 0].std() > 1.4 * clip.spine[:, 0].std()
    np.testing.assert_array_equal(large.foot_position, clip.foot_position)
