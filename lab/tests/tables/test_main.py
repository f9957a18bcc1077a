import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar_lab.tables import alignment, main, scores, tokenizer_ablation, user_study
from echoavatar_lab.tables.experiment import EXTRA_CHUNKS
from echoavatar_lab.tables.scale import SCALES, Scale


def test_every_generator_and_baseline_has_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "generation_scores", counted)
    experiment = FakeExperiment()
    table = main.make(experiment)
    assert experiment.asked == ["corruption-none", "corruption-uniform", "body-parts", "exemplars", "offline"]
    lines = {line.name: line for line in table.lines}
    assert lines["GT"].ours["fid"].value < 1e-6 < lines["Mean pose"].ours["fid"].value
    assert lines["MECo (quoted)"].paper["fid"] == 14.73
    assert not lines["MECo (quoted)"].ours
    assert "fid" not in lines["Ours (uniform corruption)"].paper
    assert not lines[main.OFFLINE].paper
    deaf, hears = (lines[name].ours["listening"] for name in (main.NONE, main.OURS_LINE))
    assert deaf.value == pytest.approx(0, abs=1e-6)
    assert abs(hears.value) > 1e-4
    assert hears.low < hears.value < hears.high


def test_the_papers_claims_name_lines_and_columns_of_their_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "generation_scores", counted)
    monkeypatch.setattr(tokenizer_ablation, "reconstruction_scores", lambda *_, **__: {})
    monkeypatch.setattr(FakeExperiment, "tokenizer", lambda *_: None, raising=False)
    made = [module.make(FakeExperiment()) for module in (main, tokenizer_ablation, user_study)]
    for table, claims, columns in [(one, one.claims, one.columns) for one in made] + [
        (None, alignment.CLAIMS, alignment.COLUMNS)
    ]:
        names = (
            {line.name for line in table.lines}
            if table
            else {alignment.UNTUNED[0]} | {name for name, _ in alignment.LINES.values()}
        )
        assert claims
        for claim in claims:
            assert {claim.winner, claim.loser} <= names
            assert set(claim.columns) <= {column.key for column in columns}
            assert set(claim.columns)


@pytest.mark.parametrize("scale", SCALES.values(), ids=SCALES)
def test_the_upper_reference_hears_half_a_window_ahead_and_fits_the_clips(scale: Scale) -> None:
    """Its training windows and what it hears beyond them are no longer than the other lines' windows."""
    choice = main.offline(scale)
    window = scale.generator.window_chunks
    ahead = choice.sizes["ahead_chunks"]
    assert 0 < ahead < window
    assert choice.training["chunks"] + ahead == window + EXTRA_CHUNKS


def test_both_orders_are_trained_and_nothing_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "generation_scores", counted)
    experiment = FakeExperiment()
    table = main.make_orders(experiment)
    assert experiment.asked == ["order-prefix", "order-interleaved"]
    assert all({"fid", "ba_g", "ba_d"} <= line.ours.keys() and not line.paper for line in table.lines)
