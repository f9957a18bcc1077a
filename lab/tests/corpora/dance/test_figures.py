import pytest

from echoavatar_lab.corpora.dance.figures import FIGURES, fitting
from echoavatar_lab.corpora.dance.grooves import GROOVES
from echoavatar_lab.corpora.dance.steps import Figure


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.name)
def test_only_one_foot_is_in_the_air(figure: Figure) -> None:
    times = sorted((step.count - step.travel, step.count) for step in figure.steps)
    for (_, landing), (lift_off, _) in zip(times, times[1:], strict=False):
        assert lift_off >= landing - 0.25
    assert all(0 <= step.count < figure.counts for step in figure.steps)


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.name)
def test_places_stay_near(figure: Figure) -> None:
    assert all(abs(step.x) < 0.5 and abs(step.z) < 0.65 and 0.04 <= step.lift <= 0.15 for step in figure.steps)


@pytest.mark.parametrize("energy", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("style", sorted(GROOVES))
def test_every_style_finds_figures_in_its_metre(style: str, energy: float) -> None:
    metre = 3 if style == "waltz" else 4
    found = fitting(style, metre, energy)
    assert found
    assert all(figure.metre == metre or figure.name == "sway" for figure in found)
