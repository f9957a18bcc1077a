from echoavatar_lab.evaluation.captured_people import KINDS, PEOPLE
from echoavatar_lab.evaluation.metrics.liveliness import STATISTICS


def test_people_have_every_statistic_in_order() -> None:
    for kind in KINDS:
        assert list(PEOPLE[kind]) == list(STATISTICS)
        assert all(low <= mean <= high for mean, low, high in PEOPLE[kind].values())
