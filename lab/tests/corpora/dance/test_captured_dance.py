import numpy as np
import pytest
from lab.tests.corpora.dance.test_phrases import stepping_in_place

from echoavatar_lab.corpora.capture.library import CapturedClip, CapturedLibrary
from echoavatar_lab.corpora.dance import captured_dance
from echoavatar_lab.corpora.dance.captured_dance import dance_to
from echoavatar_lab.corpora.sound import SoundTrack, Span


def test_captured_people_dance_some_pieces_and_each_piece_by_itself(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(captured_dance, "BY_RULE", 0.4)
    clip = CapturedClip("a", "dance", "salsa_lead", "set/a.bvh", "CC0", stepping_in_place(24.0, 0.36))
    spans = (Span(0.0, 9.0, "music"), Span(9.0, 9.4, "silence"), Span(9.4, 18.0, "music"))
    beats = np.concatenate([np.arange(0.2, 9.0, 0.45), np.arange(9.6, 18.0, 0.45)])
    track = SoundTrack(np.zeros(18 * 24_000, np.float32), spans=spans, beats=beats)
    ways = []
    for seed in range(4):
        by_rule, made = dance_to(track, seed), dance_to(track, seed, CapturedLibrary((clip,)))
        ways.append([bool(np.ptp(by_rule[s].wrist - made[s].wrist) > 0.05) for s in (slice(30, 240), slice(330, 500))])
        if not ways[-1][1]:  # the second piece is by rule; bends before it are smoothed into its first second
            np.testing.assert_allclose(by_rule[282:].packed(), made[282:].packed(), atol=2e-3)
            np.testing.assert_array_equal(by_rule[330:].packed(), made[330:].packed())
    assert np.any(ways)
    assert not np.all(ways)
