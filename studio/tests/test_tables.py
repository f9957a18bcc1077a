"""What the store itself refuses: two answers for a task, two blocks for a rater, ratings off the scale."""

import pytest
from sqlalchemy.exc import IntegrityError
from studio.tests import canned
from studio.tests.people import RaterPerson, app_of, tokens

from echoavatar_studio.making import Maker
from echoavatar_studio.tables import Block, Judgement, Rater, Task


def row(**changes) -> Judgement:
    usual = {"task_id": 1, "rater_id": 1, "key": "k", "digest": "d", "seconds": 1.0, "plays": [1, 1], "at": 0.0}
    return Judgement(**(usual | changes))


def test_the_store_keeps_its_promises(either: Maker, library):
    study = canned.make_pairwise(either, library)
    rater = RaterPerson(app_of(either)).begin(tokens(either, study, 1)[0])
    rater.answer(rater.task(), key="first-key")
    with either.store.read() as session:
        task, other = (one.id for one in session.query(Task).order_by(Task.position).limit(2))
        block = session.query(Block).filter(Block.rater_id.is_(None)).first().id
    wrong = [
        row(task_id=session.query(Judgement).one().task_id, key="another"),
        row(task_id=other, key="first-key"),
        row(task_id=other, human_likeness=3),
        row(task_id=other, best=1, worst=1),
        row(task_id=10**6),
    ]
    for judgement in wrong:
        with pytest.raises(IntegrityError), either.store.write() as session:
            session.add(judgement)
    with pytest.raises(IntegrityError), either.store.write() as session:
        session.get_one(Block, block).rater_id = session.query(Rater).one().id
    assert task != other
