from pathlib import Path

import numpy as np
import pytest
from tests.files.avatar.weights import as_skin, humanoid_weights

from echoavatar.errors import MotionError
from echoavatar.files.avatar import MATERIALS, load_character
from echoavatar.motion.ik import BodyProfile, body_of_rig, measure_body
from echoavatar.motion.kinematics import HUMANOID, Skeleton


def test_it_is_saved_and_read_back(tmp_path: Path) -> None:
    profile = body_of_rig(HUMANOID)
    profile.save(tmp_path / "body.json")
    assert BodyProfile.load(tmp_path / "body.json") == profile


@pytest.mark.parametrize("text", ["{}", "no json", '{"parts": [], "palm": 0.02}'])
def test_a_file_that_is_none_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "body.json"
    path.write_text(text)
    with pytest.raises(MotionError, match=r"body\.json is not a body profile.*measure"):
        BodyProfile.load(path)
    with pytest.raises(MotionError, match="absent.json cannot be read"):
        BodyProfile.load(tmp_path / "absent.json")


def test_a_rig_of_half_the_size_has_half_the_body() -> None:
    small = HUMANOID.config.model_copy(
        update={"offsets": tuple((x / 2, y / 2, z / 2) for x, y, z in HUMANOID.config.offsets)}
    )
    whole, half = body_of_rig(HUMANOID), body_of_rig(Skeleton(small))
    for a, b in zip(whole.parts, half.parts, strict=True):
        np.testing.assert_allclose(np.array(a.radii) / 2, b.radii, rtol=1e-4)
        np.testing.assert_allclose(np.array(a.centre) / 2, b.centre, atol=1e-5)
    assert half.palm == pytest.approx(whole.palm / 2)


def test_an_unknown_rig_is_refused() -> None:
    strange = HUMANOID.config.model_copy(
        update={"vrm": {}, "names": tuple(f"bone{i}" for i in range(52)), "offsets": ((0.0,) * 3,) * 52}
    )
    with pytest.raises(MotionError, match="is not known"):
        body_of_rig(Skeleton(strange))


CHARACTER = load_character()
SKIN = ~np.array([material.name in ("hair", "lash") for material in MATERIALS])[CHARACTER.materials]  # clothes too


def test_the_shipped_character_is_what_the_fallback_says_it_is() -> None:
    """The fallback's numbers were measured on it; cloth may change by two centimetres before this asks."""
    measured = measure_body(HUMANOID, CHARACTER.positions[SKIN], as_skin(humanoid_weights(CHARACTER)[SKIN]))
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
    rest = HUMANOID.rest_positions
    joints = HUMANOID.indices([part.bone for part in profile.parts])
    trunk = CHARACTER.positions[SKIN & (humanoid_weights(CHARACTER)[:, joints].sum(1) > 0.5)]
    sizes = [
        np.linalg.norm((trunk - rest[joint] - part.centre) / part.radii, axis=1)
        for joint, part in zip(joints, profile.parts, strict=True)
    ]
    nearest = np.min(sizes, axis=0)
    assert (nearest <= 1).mean() > 0.95
    assert nearest.max() < 1.15
    assert np.median(nearest) > 0.75


def test_a_finely_meshed_mouth_does_not_outvote_the_skull() -> None:
    positions, weights = CHARACTER.positions[SKIN], humanoid_weights(CHARACTER)[SKIN]
    lips = np.flatnonzero((weights.argmax(1) == HUMANOID.index("head")) & (positions[:, 2] > 0.08))
    order = np.concatenate([np.arange(len(positions)), np.repeat(lips, 8)])
    finer = measure_body(HUMANOID, positions[order], as_skin(weights[order]))
    assert finer.parts == measure_body(HUMANOID, positions, as_skin(weights)).parts


@pytest.mark.parametrize(("noise", "change"), [(1e-6, 2e-4), (1e-4, 1e-3)])
def test_rounding_changes_no_measure_by_more_than_its_size(noise: float, change: float) -> None:
    """No slice, cell or vertex decides alone."""
    draw, weights = np.random.default_rng(0), as_skin(humanoid_weights(CHARACTER)[SKIN])
    profile = measure_body(HUMANOID, CHARACTER.positions[SKIN], weights)
    for _ in range(4):
        moved = CHARACTER.positions[SKIN] + draw.normal(0, noise, (SKIN.sum(), 3))
        for one, other in zip(profile.parts, measure_body(HUMANOID, moved, weights).parts, strict=True):
            np.testing.assert_allclose(one.centre + one.radii, other.centre + other.radii, atol=change)


def test_meshes_that_do_not_fit_are_refused() -> None:
    vertices, weights = np.zeros((100, 3), np.float32), as_skin(np.zeros((100, HUMANOID.joints), np.float32))
    for strange in (as_skin(weights.shares[:4]), weights._replace(joints=weights.joints + 1)):
        with pytest.raises(MotionError, match="do not fit a rig of 52 joints"):
            measure_body(HUMANOID, vertices, strange)
    with pytest.raises(MotionError, match="follow the head"):
        measure_body(HUMANOID, vertices, weights)
    vertices[3] = np.nan
    with pytest.raises(MotionError, match="not finite"):
        measure_body(HUMANOID, vertices, weights)
