import numpy as np

from echoavatar_lab.corpora.dance.poses import ARMS, HANDS, Key, Move, mirrored, parse_keys


def test_poses_are_within_reach_and_unfolded() -> None:
    for name, pose in ARMS.items():
        assert 0.22 < np.linalg.norm(pose.wrist) < 0.50, name
        assert pose.vector().shape == (16,)


def test_hand_shapes_are_in_range() -> None:
    for shape in HANDS.values():
        assert len(shape) == 7
        assert all(0.0 <= value <= 1.0 for value in (*shape[:5], shape[6]))
        assert -1.0 <= shape[5] <= 1.0


def test_the_notation_is_parsed() -> None:
    both, mixed = parse_keys("0 side c:.1/0/-.05; 2.5 hip/vee h:0/.1/0")
    assert both == Key(0.0, "side", "side", (0.1, 0.0, -0.05))
    assert mixed == Key(2.5, "hip", "vee", (0.0, 0.0, 0.0), (0.0, 0.1, 0.0))


def test_a_mirror_image_changes_sides() -> None:
    move = Move("m", 4, parse_keys("1 hip/vee c:.1/.2/.3 h:.4/.5/.6"))
    (key,) = mirrored(move).keys
    assert (key.left, key.right) == ("vee", "hip")
    assert key.chest == (-0.1, 0.2, -0.3)
    assert mirrored(mirrored(move)) == move
