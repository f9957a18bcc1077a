"""Judgements with what they are about."""

from studio.tests import canned
from studio.tests.people import RaterPerson, app_of, tokens

from echoavatar_studio.answers import answer_records, counted
from echoavatar_studio.making import Maker
from echoavatar_studio.owner_actions import OwnerActions, find_study


def test_ratings_are_towards_the_first_system_however_they_were_shown(maker: Maker, library):
    """The rater always prefers the clip on the right by 2: towards place 0 that is 2 where places were swapped."""
    study = canned.make_pairwise(maker, library)
    rater = RaterPerson(app_of(maker)).begin(tokens(maker, study, 1)[0])
    while (task := rater.task()) is not None:
        rater.answer(task)
    with maker.store.read() as session:
        answers = answer_records(session, find_study(session, study))
    assert len(answers) == 9
    for answer in answers:
        assert answer.ratings["overall_preference"] == (2 if answer.order == (1, 0) else -2)
        assert answer.clip_seconds == 1.0
        assert answer.systems[-1] == "" or answer.role in ("real", "identical")
    assert len(counted(answers)) == 6
    OwnerActions(maker, "test").exclude(study, 1, is_excluded=True, reason="")
    with maker.store.read() as session:
        assert counted(answer_records(session, find_study(session, study))) == []
