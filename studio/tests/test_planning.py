"""What raters get: counts, roles, checks and sides of a whole plan."""

from collections import Counter

from studio.tests import canned

from echoavatar_studio.making import Maker
from echoavatar_studio.tables import Block, Clip, Task, Trial


def plan_of(maker: Maker):
    with maker.store.read() as session:
        rows = session.query(Task, Trial).join(Trial, Task.trial_id == Trial.id).order_by(Task.block_id, Task.position)
        blocks: dict[int, list[tuple[Task, Trial]]] = {}
        for task, trial in rows:
            blocks.setdefault(task.block_id, []).append((task, trial))
        assert len(blocks) == session.query(Block).count()
        return list(blocks.values())


def test_every_rater_gets_practice_first_and_each_check_once(maker: Maker, library):
    canned.make_pairwise(maker, library, raters=8, tasks_per_rater=6)
    used: Counter[int] = Counter()
    for block in plan_of(maker):
        roles = [trial.role for _, trial in block]
        assert roles[0] == "training"
        assert roles[1] == "real"
        assert Counter(roles) == {"training": 1, "real": 6, "identical": 1, "corrupted": 1}
        assert [task.position for task, _ in block] == list(range(9))
        used.update(trial.id for _, trial in block if trial.role == "real")
    assert set(used.values()) == {4}  # 8 raters, 6 of 12 trials each


def test_sides_are_balanced_over_raters(maker: Maker, library):
    canned.make_pairwise(maker, library, raters=8, tasks_per_rater=12)
    swapped: Counter[int] = Counter()
    for block in plan_of(maker):
        swapped.update({trial.id: int(task.order == [1, 0]) for task, trial in block if trial.role == "real"})
    assert set(swapped.values()) == {4}


def test_corrupted_clips_have_the_last_place_and_identical_ones_are_identical(maker: Maker, library):
    canned.make_pairwise(maker, library)
    canned.make_preference(maker)
    with maker.store.read() as session:
        corrupted = {clip.id for clip in session.query(Clip).filter(Clip.system_id.is_(None))}
        for trial in session.query(Trial):
            if trial.role in ("corrupted", "training"):
                assert [clip in corrupted for clip in trial.clips] == [False] * (len(trial.clips) - 1) + [True]
            elif trial.role == "identical":
                assert len(set(trial.clips)) == 1
            else:
                assert not corrupted & set(trial.clips)


def test_systems_of_different_groups_never_meet(maker: Maker, library):
    systems = [{"name": f"{name} {g}", "clips": name, "group": g} for g in "AB" for name in ("Alpha", "Beta")]
    canned.make_pairwise(maker, library, systems=systems)
    with maker.store.read() as session:
        assert session.query(Trial).filter(Trial.role == "real").count() == 2 * 4  # two pairs, four sounds
