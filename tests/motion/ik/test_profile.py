from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.motion.ik import BodyProfile, body_of_rig
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
    strange = HUMANOID.config.model_copy(update={"vrm": {}, "names": tuple(f"bone{i}" for i in range(52))})
    with pytest.raises(MotionError, match="VRM map"):
        body_of_rig(Skeleton(strange))
