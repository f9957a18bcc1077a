"""Whatever reads a file names it once, and says what was assumed in one line."""

import logging
from pathlib import Path

import pytest

from echoavatar.errors import MotionError
from echoavatar.motion.formats.reading import reading
from echoavatar.motion.kinematics import SkeletonConfig
from echoavatar.motion.kinematics.rigs import UnknownRigError

PATH = Path("a.bvh")


def test_what_was_assumed_is_one_line(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING), reading(PATH) as notes:
        notes += ["it is turned", "its unit is taken for metres"]
    assert caplog.messages == ["a.bvh: it is turned; its unit is taken for metres"]
    with reading(PATH):
        pass
    assert len(caplog.messages) == 1


def test_an_error_names_the_file_once_and_stays_what_it_is(caplog: pytest.LogCaptureFixture) -> None:
    for said in ("it has no frames", "a.bvh has no frames", "a.bvh, line 3: no frames", "a.bvh: no frames"):
        with pytest.raises(UnknownRigError) as caught, reading(PATH), reading(PATH):
            raise UnknownRigError(said, {"hips": "Hips"})
        assert str(caught.value) == (said if said.startswith("a.bvh") else f"a.bvh: {said}")
        assert caught.value.found == {"hips": "Hips"}
    with (
        pytest.raises(MotionError, match="^a.bvh: .*the first joint must be the root.*; repair the file"),
        reading(PATH),
    ):
        SkeletonConfig(names=("a",), parents=(0,), offsets=((0, 0, 0),))
    assert not caplog.messages
