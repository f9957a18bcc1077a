import pytest
from pydantic import ValidationError

from echoavatar_lab.models.face.recipe import FaceTraining


def test_windows_are_whole_chunks_and_unknown_names_are_refused():
    assert FaceTraining(frames=32).frames == 32
    with pytest.raises(ValidationError, match="frames"):
        FaceTraining(frames=30)
    with pytest.raises(ValidationError, match="lip"):
        FaceTraining(lip=0.3)
