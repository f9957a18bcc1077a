import pytest

from echoavatar import errors


@pytest.mark.parametrize(
    "kind",
    [
        errors.AudioError,
        errors.MotionError,
        errors.CheckpointError,
        errors.DependencyError,
        errors.AdmissionError,
        errors.QueueFullError,
    ],
)
def test_every_kind_is_one_the_command_line_reports(kind: type[Exception]) -> None:
    assert issubclass(kind, errors.EchoAvatarError)
