from pathlib import Path

from echoavatar.evaluation.reliance import reliance, reliance_table, token_clips
from echoavatar.pipeline import load_bundle
from echoavatar.rehearsal.corpus import Plan, make_clip


def test_a_model_that_knows_nothing_loses_nothing_when_the_audio_is_exchanged(tiny_bundle: Path) -> None:
    bundle = load_bundle(tiny_bundle)
    clips = [make_clip(Plan(1.0, 44, Path("unused"), clip_seconds=16.0), index) for index in range(2)]
    tokens = token_clips(bundle, clips)
    scores = reliance(bundle.generator, tokens)
    assert abs(scores["nll_gain_all"]) < 0.1
    assert scores["nll_gain_all"] == scores["nll_shuffled_all"] - scores["nll_all"]
    table = reliance_table({"a": bundle.generator, "b": bundle.generator}, tokens).splitlines()
    assert table[0].count("|") == table[1].count("|") == table[-1].count("|") == 8
    assert table[-1].startswith("| all |")
