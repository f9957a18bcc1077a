import numpy as np
import pytest
from tests.engine.fakes import engine

from echoavatar.engine.manner import SpeakerManner
from echoavatar.engine.pipeline import Action, ActionLibrary
from echoavatar.models.generator.manner import MANNER, draw_manner
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.timing import ChunkSize


def test_it_wanders_slowly_around_what_the_seed_drew():
    manner = SpeakerManner(7, FREE)
    all_told = np.stack([manner.at(chunk) for chunk in range(900)])
    minutes = all_told[:, : len(MANNER)]
    assert np.abs(minutes - minutes.mean(0)).max() < 0.3
    assert np.abs(np.diff(minutes, axis=0)).max() < 0.01
    assert np.ptp(minutes[:, MANNER.index("liveliness")]) > 0.05
    again = np.stack([SpeakerManner(7, FREE).at(chunk) for chunk in range(900)])
    assert np.array_equal(all_told, again, equal_nan=True)
    assert not np.array_equal(SpeakerManner(8, FREE).at(0), all_told[0], equal_nan=True)


def test_what_a_session_is_told_follows_what_its_seed_drew():
    own = np.array([told(seed)[:, : len(MANNER)].mean(0) for seed in range(16)]).T
    drawn = np.array([draw_manner(seed).values for seed in range(16)]).T
    for name, here, there in zip(MANNER[:-1], own, drawn, strict=False):  # idle hands hang at the sides
        assert np.corrcoef(here, there)[0, 1] > 0.8, name


def hands_of(seed: int, liveliness: float | None = None, handedness: float | None = None):
    """How busy both hands are in four minutes of talk."""
    return told(seed, liveliness, handedness)[:, len(MANNER) : -2]


def told(seed: int, liveliness: float | None = None, handedness: float | None = None):
    """What a session is told in four minutes of talk."""
    manner = SpeakerManner(seed, MotionOptions(liveliness=liveliness, handedness=handedness))
    return np.stack([manner.at(chunk) for chunk in range(900)])


def test_hands_take_turns_of_some_seconds():
    hands = np.concatenate([hands_of(seed) for seed in range(12)])
    lazy, busy = hands.min(1), hands.max(1)
    assert 0.15 < np.mean((lazy < 0.25) & (busy > 0.4)) < 0.5, "one hand works and the other rests"
    assert 0.12 < np.mean(lazy > 0.4) < 0.7, "both work"
    assert 0.02 < np.mean(busy < 0.25) < 0.3, "neither works"
    assert np.abs(np.diff(hands_of(3), axis=0)).max() < 0.2, "no hand starts at once"
    assert hands.min() >= 0
    assert hands.max() <= 1


def test_a_livelier_speaker_has_busier_hands_and_the_leading_hand_is_the_one_that_was_set():
    means = [np.mean([hands_of(seed, liveliness=value).mean() for seed in range(6)]) for value in (0, 0.2, 0.5, 0.8, 1)]
    assert all(np.diff(means) > 0.02)
    assert means[-1] > 1.8 * means[0]
    left, right = (np.mean([hands_of(seed, handedness=value).mean(0) for seed in range(6)], axis=0) for value in (0, 1))
    assert left[0] > left[1] + 0.1
    assert right[1] > right[0] + 0.1


def test_where_the_hand_is_set_the_other_is_down_while_it_rests():
    assert np.isnan(told(4)[:, -2:]).all(), "else it rests where it likes"
    alone, led = (np.concatenate([told(seed, handedness=x)[:, -2:] for seed in range(6)]) for x in (1.0, 0.8))
    assert np.isnan(alone[:, 1]).all()
    assert np.mean(alone[:, 0] < 0.3) > 0.9, "the right hand alone"
    assert 0.4 < np.mean(led[:, 0] < 0.3) < 0.9


def test_in_silence_both_hands_are_idle():
    manner = SpeakerManner(7, MotionOptions(liveliness=1.0))
    assert manner.at(40, is_silent=True)[len(MANNER) : -2].max() < 0.2
    for level in (0.0, 0.3):
        with engine().open(seed=3, options=MotionOptions(liveliness=1.0)) as session:
            session.push(np.full(6_400, level, np.float32))
            busiest = session.core.begin_chunk(0).manner[len(MANNER) : -2].max()
            assert (busiest < 0.2) == (level == 0)


@pytest.mark.parametrize(("liveliness", "busy"), [(None, 1.0), (0.9, 1.0), (0.0, 0.4)])
def test_hands_that_rest_for_too_long_are_told_that_one_works(liveliness: float | None, busy: float):
    manner = SpeakerManner(7, MotionOptions(liveliness=liveliness))
    at_rest, rested = (manner.at(40, rests=rests)[len(MANNER) : -2] for rests in (False, True))
    assert rested[at_rest.argmax()] == pytest.approx(busy)
    assert rested[at_rest.argmin()] == at_rest.min(), "the other goes on as it would"
    assert manner.at(40, rests=True, is_silent=True)[len(MANNER) : -2].max() < 0.2


@pytest.mark.parametrize("additions", [{"settling"}, set()])
def test_a_session_whose_hands_rest_while_sound_goes_on_is_told_so(additions: set[str]):
    machine = engine()
    machine.additions = frozenset(additions)
    core = machine.open_core(seed=3)
    core.push(np.full(6_400 * 4, 0.1, np.float32))
    for _ in range(3):
        machine.tick()
    busiest = core.begin_chunk(0).manner[len(MANNER) : -2].max()
    assert (busiest == 1) == bool(additions)


def test_a_session_is_told_its_manner_and_numbers_out_of_range_are_refused():
    with engine().open(seed=3, options=MotionOptions(liveliness=0.4)) as session:
        session.core.set_manner(handedness=1.0)
        session.push(np.zeros(6_400, np.float32))
        plan = session.core.begin_chunk(0)
        assert 0.3 < plan.manner[MANNER.index("liveliness")] <= 0.4
        assert plan.manner[MANNER.index("right")] == 1
        with pytest.raises(ValueError, match="liveliness"):
            session.core.set_manner(liveliness=1.5)


def test_a_speaker_who_is_asked_to_gesture_more_moves_further_and_one_who_is_not_asked_as_in_the_middle():
    sizes = [sizes_of(liveliness=value)[0] for value in (0, 0.2, 0.5, 0.8, 1)]
    assert all(np.diff(sizes) > 0)
    assert sizes[0] < 0.5 < 1 < sizes[2] == sizes_of()[0] < sizes[-1]


def test_the_hand_that_is_not_set_moves_less():
    left, middle, right = (sizes_of(handedness=value) for value in (0, 0.5, 1))
    assert {left[0], right[1], *middle} == {sizes_of()[0]}
    assert left[1] < 0.5 > right[0]


def sizes_of(**options: float) -> tuple[float, float]:
    manner = SpeakerManner(3, MotionOptions(**options))
    return tuple(np.max([manner.hands(chunk)[:2] for chunk in range(200)], axis=0))


@pytest.mark.parametrize("wanted", ["nothing", "wave", "music"])
def test_a_small_gesturer_acts_and_dances_whole(wanted: str):
    machine = engine()
    machine.actions = ActionLibrary({"wave": Action("wave", (1, 2, 3, 4), (0, 1))})
    core = machine.open_core(options=MotionOptions(liveliness=0))
    core.push(np.full(6_400, 0.1, np.float32))
    if wanted == "music":
        core.play("piece", np.full(24_000, 0.1, np.float32))
    if wanted == "wave":
        core.act("wave")
    assert (core.begin_chunk(0).hands[0] < 0.5) == (wanted == "nothing")


def test_a_speaker_is_the_same_whatever_the_chunk() -> None:
    """Two chunks of four frames are told what one of eight is."""
    whole, half = SpeakerManner(7, FREE), SpeakerManner(7, FREE, ChunkSize(1))
    for chunk in range(60):
        for part in (2 * chunk, 2 * chunk + 1):
            np.testing.assert_array_equal(half.at(part), whole.at(chunk))
            np.testing.assert_array_equal(half.hands(part), whole.hands(chunk))
