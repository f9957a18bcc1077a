import numpy as np
import pytest

from echoavatar.engine.action_scheduler import ActionScheduler
from echoavatar.engine.pipeline import Action, ActionLibrary
from echoavatar.motion.action_overlay import Overlay

WAVE, BOW = Action("wave", (1, 1, 2, 2, 3, 3, 4, 4), (1, 3)), Action("bow", (5, 6, 7, 5), (0, 1))


@pytest.fixture
def actions() -> ActionScheduler:
    return ActionScheduler(ActionLibrary({"wave": WAVE, "bow": BOW}))


def reported(actions: ActionScheduler) -> list[tuple[str, str]]:
    return [(status.name, status.status) for status in actions.take()]


def test_an_action_is_accepted_started_done_and_never_sticks(actions: ActionScheduler) -> None:
    """Four chunks long, asked for at chunk 10: it holds in 10 to 13 and at no other time."""
    asked = actions.ask("Wave", chunk=10)
    assert (asked.status, asked.at) == ("accepted", 64_000)
    held = []
    for chunk in range(9, 16):
        held.append(actions.members(chunk, 8) is not None)
        actions.report_made(chunk)
        actions.report_made(chunk)  # a chunk may go out again after a barge-in: nothing is reported twice
    assert held == [False, True, True, True, True, False, False]
    assert reported(actions) == [("wave", "accepted"), ("wave", "started"), ("wave", "done")]


def test_holding_repeats_the_middle_and_ends_with_the_end(actions: ActionScheduler) -> None:
    """2.7 s are ten chunks: one in, the two that repeat, one out."""
    actions.ask("wave", chunk=0, hold_s=2.7)
    places = [WAVE.place(chunk, 10) for chunk in range(10)]
    assert places == [0, 1, 2, 1, 2, 1, 2, 1, 2, 3]
    assert actions.members(9, 8) is not None
    assert actions.members(10, 8) is None


def test_a_new_action_ends_the_one_before(actions: ActionScheduler) -> None:
    actions.ask("wave", chunk=0, id="a")
    actions.report_made(0)
    actions.ask("bow", chunk=1, id="b")
    actions.report_made(1)
    actions.report_made(2)
    statuses = actions.take()
    assert [(s.id, s.status) for s in statuses] == [
        ("a", "accepted"),
        ("a", "started"),
        ("b", "accepted"),
        ("a", "done"),
        ("b", "started"),
        ("b", "done"),
    ]
    assert "bow was asked for" in statuses[3].reason


def test_what_cannot_be_is_rejected_with_the_reason(actions: ActionScheduler) -> None:
    assert "there are: wave, bow" in actions.ask("moonwalk", chunk=0).reason
    assert "intensity 9" in actions.ask("wave", chunk=0, intensity=9).reason
    assert "hold nan" in actions.ask("wave", chunk=0, hold_s=float("nan")).reason
    actions.ask("wave", chunk=0, id="x")
    assert "used already" in actions.ask("bow", chunk=0, id="x").reason
    assert [status for _, status in reported(actions)] == ["rejected"] * 3 + ["accepted", "rejected"]


def test_intensity_scales_the_set_and_edges_are_softer(actions: ActionScheduler) -> None:
    actions.ask("wave", chunk=0, intensity=0.5)
    edge, inside = actions.members(0, 8), actions.members(1, 8)
    assert edge is not None
    assert inside is not None
    assert np.flatnonzero(edge).tolist() == [1, 2]
    assert np.flatnonzero(inside).tolist() == [1, 2, 3]
    assert inside.max() == 0.5 > edge.max()


def test_what_is_put_on_top_goes_on_without_a_step_when_held_and_when_cut_short() -> None:
    turns = np.zeros((32, 1, 3), np.float32)
    turns[:, 0, 0] = np.linspace(0, 0.6, 32)
    nod = Action("nod", (1,) * 8, (1, 3), overlay=Overlay(("head",), turns))
    actions = ActionScheduler(ActionLibrary({"nod": nod}))
    actions.ask("nod", chunk=0, hold_s=2.1)
    actions.stop(6)
    shown = [actions.overlay(chunk) for chunk in range(7)]
    assert actions.overlay(7) is None
    path = np.concatenate([overlay.rotation_vectors[:, 0, 0] for overlay in shown if overlay])
    assert len(path) == 7 * 8
    assert np.abs(np.diff(path)).max() < 0.14
    np.testing.assert_allclose(path[:24], turns[:24, 0, 0])  # one in, two that will repeat
    assert path[-1] == 0


def test_a_day_of_nods_takes_no_memory(actions: ActionScheduler) -> None:
    for chunk in range(3_000):
        actions.ask("wave", chunk=chunk, intensity=1.0, hold_s=None, is_own=True)
    assert len(actions._reported) + len(actions._actions) < 1_100
