from echoavatar_lab.corpora.music.instruments import TIMBRES
from echoavatar_lab.corpora.music.soundfont import _DRUMS, _PROGRAMS
from echoavatar_lab.corpora.music.styles import STYLES


def test_every_row_fills_exactly_one_bar():
    for style in STYLES.values():
        rows = [style.bass, style.chords, *(row for _, row in style.drums)]
        assert {len(row) for row in rows} == {style.steps}, style.name
        assert set("".join(rows)) <= set("xo-")


def test_every_instrument_can_be_played_by_both_renderers():
    for style in STYLES.values():
        pitched = {*style.leads, *style.comps, *style.basses}
        assert pitched <= set(TIMBRES), style.name
        assert pitched <= set(_PROGRAMS), style.name
        assert {drum for drum, _ in style.drums} <= set(_DRUMS)


def test_styles_differ_in_metre_and_drumless_ones_exist():
    assert {style.beats_per_bar for style in STYLES.values()} == {2, 3, 4}
    assert any(not style.drums for style in STYLES.values())
