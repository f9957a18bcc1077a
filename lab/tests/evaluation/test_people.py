import json
from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.test_takes import captured, name_people, write_sound
from tests.motion.kinematics.samples import swaying

from echoavatar.cli import main
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.motion.formats import write_bvh
from echoavatar_lab.evaluation import people
from echoavatar_lab.evaluation.metrics.liveliness import KINDS, STATISTICS
from echoavatar_lab.evaluation.table import mean_interval

SHARED = Path(__file__).parents[4] / "shared/data"


def dancers(folder: Path) -> Path:
    """Ann sways a little in two clips, Bob much in one."""
    folder.mkdir()
    for name, size in (("ann1", 0.1), ("ann2", 0.2), ("bob1", 0.6)):
        motion = swaying(400, size=size)
        write_bvh(folder / f"{name}.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    return name_people(
        folder, ("music", "ann", "any", "ann1"), ("music", "ann", "evaluation", "ann2"), ("music", "bob", "any", "bob1")
    )


def test_the_list_names_kind_and_person(tmp_path: Path) -> None:
    write_sound(dancers(tmp_path / "set") / "bob1.wav", 3)
    takes = people.read_people(tmp_path / "set")
    assert [(take.name, take.kind, take.group) for take in takes] == [
        ("ann1.bvh", "music", "ann"),
        ("ann2.bvh", "music", "ann"),
        ("bob1.bvh", "music", "bob"),
    ]
    assert [take.audio is not None for take in takes] == [False, False, True]
    taught = people.read_people(tmp_path / "set", for_training=True)
    assert [take.name for take in taught] == ["ann1.bvh", "bob1.bvh"]  # what is for evaluation only trains nothing


def test_means_and_intervals_are_over_people_not_over_clips(tmp_path: Path) -> None:
    rows = people.measured(people.read_people(dancers(tmp_path / "set")), 10)
    found = people.statistics(rows)["music"]["hand_speed"]
    ann, bob = (np.mean([row["hand_speed"] for row in rows["music"][who]]) for who in ("ann", "bob"))
    assert found.mean == pytest.approx((ann + bob) / 2)
    assert found.interval == pytest.approx(mean_interval(np.array([ann, bob])))
    assert (found.low, found.high) == pytest.approx(
        (min(row["hand_speed"] for row in rows["music"]["ann"]), rows["music"]["bob"][0]["hand_speed"])
    )


def test_the_command_writes_the_card_which_is_read_again(tmp_path: Path, tiny_bundle: Path, capsys) -> None:
    folder, card = captured(tmp_path / "set"), tmp_path / "card.json"
    card.write_text('{"name": "mine"}', "utf-8")
    asked = ["evaluate", str(tiny_bundle), "people", "--captured", str(folder), "--card", str(card), "--seconds", "10"]
    assert main(asked) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["speech"]["people"] == ["ann", "bob"]
    assert json.loads(card.read_text())["name"] == "mine"
    with pytest.raises(EchoAvatarError, match="holds no statistics of people"):
        people.of_card(card)  # nobody waits
    motion = swaying(400, size=0.01)
    write_bvh(folder / "idle.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    with (folder / people.LIST).open("a") as file:
        file.write("silence,cid,any,idle.bvh\n")
    assert main(asked) == 0
    kept, made = people.of_card(card), people.statistics(people.measured(people.read_people(folder), 10))
    assert kept["listening"] == kept["silence"]
    assert kept["speech"]["room"].mean == pytest.approx(made["speech"]["room"].mean, abs=1e-4)


def test_the_shipped_card_has_every_statistic_with_its_interval() -> None:
    found = people.of_card()
    assert set(found) == set(KINDS)
    for kind, of in found.items():
        assert list(of) == list(STATISTICS)
        for name, one in of.items():
            assert one.low <= one.interval.low <= one.mean <= one.interval.high <= one.high, (kind, name)


@pytest.mark.slow
def test_the_shipped_card_is_what_the_named_clips_give() -> None:
    """Two kinds of the list, measured again; the third takes too long."""
    if not SHARED.is_dir():
        pytest.skip("needs ../shared/data, the folder of the named clips")
    takes = [take for take in people.read_people(SHARED) if take.kind == "speech"]
    made, kept = people.statistics(people.measured(takes))["speech"], people.of_card()["speech"]
    for name in STATISTICS:
        own, told = ((one.mean, *one.interval, one.low, one.high) for one in (made[name], kept[name]))
        assert own == pytest.approx(told, abs=1e-3), name


def test_a_bad_list_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match=r"lacks 62 of the 62 named clips, such as motion_eval_only.*people\.csv"):
        people.read_people(tmp_path)
    name_people(tmp_path, ("singing", "ann", "any", "a"))
    with pytest.raises(EchoAvatarError, match="line 2: 'singing,ann,any,a.bvh' is no clip"):
        people.read_people(tmp_path)
    (tmp_path / people.LIST).write_text("kind,person,use,clip\n")
    with pytest.raises(EchoAvatarError, match="names no clip"):
        people.read_people(tmp_path)
    name_people(tmp_path, ("speech", "ann", "any", "a"))
    for frames in (297, 300):
        motion = swaying(frames)
        write_bvh(tmp_path / "a.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
        if frames == 297:
            with pytest.raises(MotionError, match="lasts 9.9 s, a named clip 10 s or more"):
                people.read_people(tmp_path)
    assert len(people.read_people(tmp_path)) == 1  # ten seconds are enough
