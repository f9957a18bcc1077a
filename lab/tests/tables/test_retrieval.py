from echoavatar_lab.evaluation.metrics.retrieval import chance
from echoavatar_lab.tables.retrieval import COLUMNS, QUOTED, _lines, _paper
from echoavatar_lab.tables.table import Table


def test_the_papers_chance_is_chance_but_for_its_mrr() -> None:
    for pairs, quoted in ((1808, QUOTED[2]), (300, QUOTED[5])):
        guess = chance(pairs, (1, 3, 5, 10))
        for wanted, found in zip(guess.recall.values(), quoted.a2m, strict=False):
            assert abs(wanted - found) < 0.006
        assert abs(guess.median_rank - quoted.a2m[4]) <= 0.5
    assert round(chance(1808, (1,)).reciprocal_rank, 3) == 0.447  # the paper says 0.41
    assert round(chance(300, (1,)).reciprocal_rank, 2) == QUOTED[5].a2m[5]


def test_every_column_has_the_papers_numbers_and_ours() -> None:
    found = chance(10, (1, 3, 5, 10))
    ours, guess = _lines("all (10)", found, found)
    keys = [column.key for column in COLUMNS]
    assert list(_paper(QUOTED[0])) == list(ours.ours) == list(guess.ours) == keys
    assert Table("t", "", COLUMNS, [ours]).has_ours(COLUMNS[0])
