import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.files.avatar import MATERIALS, load_character
from echoavatar.motion.ik import body_of_rig, measure_body
from echoavatar.motion.kinematics import HUMANOID

CHARACTER = load_character()
SKIN = ~np.array([material.name in ("hair", "lash") for material in MATERIALS])[CHARACTER.materials]  # clothes too


def test_the_shipped_character_is_what_the_fallback_says_it_is() -> None:
    """The fallback's numbers were measured on it; cloth may change by two centimetres before this asks."""
    measured = measure_body(HUMANOID, CHARACTER.positions[SKIN], CHARACTER.dense_weights[SKIN])
    known = body_of_rig(HUMANOID)
    assert [part.bone for part in measured.parts] == [part.bone for part in known.parts]
    for ours, theirs in zip(known.parts, measured.parts, strict=True):
        loose = 0.03 if ours.bone == "neck" else 0.02  # where chin and collar end is a matter of centimetres
        np.testing.assert_allclose(ours.radii, theirs.radii, atol=loose)
        np.testing.assert_allclose(ours.centre, theirs.centre, atol=0.02)
    assert 0.015 < measured.palm < 0.03
    assert 0.006 < measured.finger < 0.015


def test_the_ellipsoids_hold_the_trunk_and_little_air() -> None:
    profile = body_of_rig(HUMANOID)
    rest = HUMANOID.rest_positions.numpy()
    joints = HUMANOID.indices([part.bone for part in profile.parts])
    trunk = CHARACTER.positions[SKIN & (CHARACTER.dense_weights[:, joints].sum(1) > 0.5)]
    sizes = [
        np.linalg.norm((trunk - rest[joint] - part.centre) / part.radii, axis=1)
        for joint, part in zip(joints, profile.parts, strict=True)
    ]
    nearest = np.min(sizes, axis=0)
    assert (nearest <= 1).mean() > 0.95
    assert nearest.max() < 1.15
    assert np.median(nearest) > 0.75


def test_a_finely_meshed_mouth_does_not_outvote_the_skull() -> None:
    positions, weights = CHARACTER.positions[SKIN], CHARACTER.dense_weights[SKIN]
    lips = np.flatnonzero((weights.argmax(1) == HUMANOID.index("head")) & (positions[:, 2] > 0.08))
    order = np.concatenate([np.arange(len(positions)), np.repeat(lips, 8)])
    finer = measure_body(HUMANOID, positions[order], weights[order])
    assert finer.parts == measure_body(HUMANOID, positions, weights).parts


def test_meshes_that_do_not_fit_are_refused() -> None:
    vertices, weights = np.zeros((100, 3), np.float32), np.zeros((100, HUMANOID.joints), np.float32)
    with pytest.raises(MotionError, match="do not fit a rig of 52 joints"):
        measure_body(HUMANOID, vertices, weights[:, :4])
    with pytest.raises(MotionError, match="follow the head"):
        measure_body(HUMANOID, vertices, weights)
    vertices[3] = np.nan
    with pytest.raises(MotionError, match="not finite"):
        measure_body(HUMANOID, vertices, weights)
