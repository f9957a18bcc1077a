"""Raters' messages: the three kinds of answer are told apart, and numbers keep their range."""

import msgspec
import pytest

from echoavatar_studio.wire_rater import Answer, PairwiseAnswer, PreferenceAnswer, RaterTask, SkipAnswer


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (b'{"type":"pairwise","ratings":{"beat_matching":-2},"seconds":1,"plays":[1,2]}', PairwiseAnswer),
        (b'{"type":"preference","best":0,"worst":7,"seconds":1,"plays":[]}', PreferenceAnswer),
        (b'{"type":"skip","reason":"no_difference","seconds":1,"plays":[]}', SkipAnswer),
    ],
)
def test_answers_are_told_apart(text, kind):
    assert isinstance(msgspec.json.decode(text, type=Answer), kind)


@pytest.mark.parametrize(
    "text",
    [
        b'{"type":"pairwise","ratings":{"beauty":1},"seconds":1,"plays":[1]}',
        b'{"type":"pairwise","ratings":{"beat_matching":-3},"seconds":1,"plays":[1]}',
        b'{"type":"preference","best":16,"worst":0,"seconds":1,"plays":[]}',
        b'{"type":"skip","reason":"bored","seconds":1,"plays":[]}',
        b'{"type":"skip","reason":"no_difference","seconds":1e9,"plays":[]}',
        b'{"type":"skip","reason":"no_difference","seconds":1,"plays":[-1]}',
    ],
)
def test_what_is_out_of_range_is_refused(text):
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(text, type=Answer)


def test_a_task_tells_nothing_but_this():
    fields = set(RaterTask.__struct_fields__)
    assert fields == {"id", "stage", "number", "seconds", "audio", "clips", "first"}
