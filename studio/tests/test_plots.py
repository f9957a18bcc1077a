"""Pictures are drawn whatever there is, the same every time."""

from echoavatar_studio.plots import draw_means, draw_ranking
from echoavatar_studio.wire import QUESTIONS
from echoavatar_studio.wire_owner import Mean, ResultRow, Strength


def test_means_and_ranking():
    score = Mean(mean=0.5, half=0.2, half_raters=None, count=9)
    rows = [
        ResultRow(system=name, group="", category=kind, scores=dict.fromkeys(QUESTIONS, score))
        for name in ("Ours", "Other")
        for kind in ("dance", "gesture")
    ]
    picture = draw_means(rows, QUESTIONS)
    assert picture.startswith(b"<?xml")
    assert b"Human Likeness" in picture or picture.count(b"<path") > 50  # text is drawn as paths
    ranking = [
        Strength(
            system=name, group="", question="overall_preference", category="all", strength=at, low=at - 1, high=at + 1,
            rank=1 + number,
        )
        for number, (name, at) in enumerate((("Ours", 0.5), ("Other", -0.5)))
    ]  # fmt: skip
    assert b"</svg>" in draw_ranking(ranking)


def test_nothing_to_draw_is_a_picture_too():
    assert b"</svg>" in draw_means([], QUESTIONS[:1])
    assert b"</svg>" in draw_ranking([])


def test_names_with_a_dollar_are_names():
    score = Mean(mean=0.5, half=0.2, half_raters=None, count=9)
    rows = [ResultRow(system="Ours $x_{$", group="", category="dance", scores=dict.fromkeys(QUESTIONS, score))]
    assert b"Ours $x_{$" in draw_means(rows, QUESTIONS)
    strength = Strength(
        system="Ours $x_{$", group="", question="overall_preference", category="all", strength=0, low=0, high=0, rank=1
    )
    assert b"Ours $x_{$" in draw_ranking([strength])
