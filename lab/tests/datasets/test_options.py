import pytest
from pydantic import ValidationError

from echoavatar_lab.datasets.options import Options


def test_only_options_that_change_clips_change_the_digest():
    plain = Options()
    assert plain.digest() == Options(shard_minutes=3, sound="any", test_every=4, mirror=False).digest()
    for other in (Options(rig="native"), Options(fingers="keep"), Options(seed=1)):
        assert other.digest() != plain.digest()


def test_invalid_options_are_refused():
    with pytest.raises(ValidationError):
        Options(rig="mine")
    with pytest.raises(ValidationError):
        Options(length_tolerance=0)
