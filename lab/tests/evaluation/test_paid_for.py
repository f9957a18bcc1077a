from echoavatar_lab.evaluation.metrics.liveliness import STATISTICS
from echoavatar_lab.evaluation.paid_for import marked


def test_rows_that_were_tuned_to_are_marked_on_recordings_too_and_others_are_not() -> None:
    assert all(marked(name) == f"{name}*" for name in STATISTICS)
    assert marked("recordings_told_apart") == "recordings_told_apart*"
    assert marked("skate") == "skate"
