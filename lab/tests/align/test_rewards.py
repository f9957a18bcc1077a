"""Matched filters: truth scores 1, ignorance 0, stillness nothing."""

from dataclasses import replace

import numpy as np
import pytest
from lab.tests.align.moving_bodies import FRAMES, LEAD, dips, reference_statistics, scene

from echoavatar.errors import CheckpointError, EchoAvatarError, MotionError
from echoavatar_lab.align.rewards import (
    BUILT_IN,
    ReferenceStatistics,
    RewardMix,
    event_frames,
    measure_reference_statistics,
    parse_weights,
    response,
)

BEATS = (0.5, 1.0, 1.5)


def measured() -> ReferenceStatistics:
    return measure_reference_statistics([scene(dips(BEATS), beats=BEATS) for _ in range(20)])


def test_motion_that_is_as_the_truth_responds_with_one():
    own = measured()
    assert response(scene(dips(BEATS), beats=BEATS), "beat", own).sum() == pytest.approx(1.0, abs=0.02)
    assert abs(sum(own.beat)) < 1e-9


def test_shallower_dips_respond_less_and_dips_between_the_beats_negatively():
    own = measured()
    shallow = response(scene(dips(BEATS, depth=0.3), beats=BEATS), "beat", own).sum()
    assert 0.2 < shallow < 0.6
    off = response(scene(dips((0.25, 0.75, 1.25, 1.75)), beats=BEATS), "beat", own).sum()
    assert off < -0.3


def test_neither_speed_nor_stillness_is_of_use():
    """Steady motion at any speed responds with nothing; so does a body that hardly moves but dips."""
    own = measured()
    for level in (0.01, 0.5, 2.0):
        assert abs(response(scene(dips((), level=level), beats=BEATS), "beat", own).sum()) < 0.02
    assert abs(response(scene(dips(BEATS, level=0.002), beats=BEATS), "beat", own).sum()) < 0.1


def test_motion_that_does_not_know_of_the_beats_scores_nothing_on_average():
    """100 scenes with dips anywhere: the mean is zero within three standard errors, and the spread is not."""
    random, own = np.random.default_rng(0), measured()
    found = [
        response(scene(dips(random.uniform(0, 2.4, 4)), beats=random.uniform(0.3, 2.0, 3)), "beat", own).sum()
        for _ in range(100)
    ]
    assert abs(np.mean(found)) < 3 * np.std(found) / 10
    assert np.std(found) > 0.1


def test_credit_goes_to_the_frames_that_earn_it():
    per_frame = response(scene(dips((1.0,)), beats=(1.0,)), "beat", measured())
    assert per_frame[25:36].sum() > 0.6 * per_frame.sum()
    assert np.abs(per_frame[45:]).max() < 1e-9


def test_events_whose_profile_does_not_fit_do_not_count():
    assert event_frames(scene(dips(()), beats=(0.1, 1.0, 2.2)), "beat") == [30]


def test_files(tmp_path):
    own = reference_statistics()
    own.save(tmp_path / "y.json")
    assert ReferenceStatistics.load(tmp_path / "y.json") == own
    with pytest.raises(CheckpointError, match="holds no reference statistics"):
        ReferenceStatistics.load(tmp_path / "other.json")


def test_truth_without_events_is_refused():
    with pytest.raises(MotionError, match="fewer than 20 beats and stresses"):
        measure_reference_statistics([scene(dips(()))])


STEADY = dips(())


def say(name: str, made, **changes) -> float:
    return float(np.sum(BUILT_IN[name](made, reference_statistics(**changes))))


def test_braking_on_the_beats_pays_and_braking_between_them_does_not():
    on, off = scene(dips(BEATS), beats=BEATS), scene(dips((0.25, 0.75, 1.25, 1.75)), beats=BEATS)
    assert say("beats", on) > 0.5
    assert say("beats", off) < 0
    braking = scene(dips([beat + 0.08 for beat in BEATS]), beats=BEATS)  # BA_D's beat is the hardest braking
    assert say("beat_alignment", braking) > 0.3
    assert say("beat_alignment", off) < 0.05


def test_strokes_on_stresses_pay():
    rise = 1.0 - dips(BEATS)
    assert say("stresses", scene(rise, stresses=BEATS)) > 0.3
    assert say("stresses", scene(dips(BEATS), stresses=BEATS)) < 0
    ends = tuple(beat + 0.18 for beat in BEATS)
    assert say("stress_alignment", scene(dips(ends), stresses=BEATS)) > 0.1


def test_without_events_timing_says_nothing():
    for name in ("beats", "stresses", "beat_alignment", "stress_alignment"):
        assert say(name, scene(dips(BEATS))) == 0


def test_timing_is_credited_where_it_is_made():
    braking = scene(dips([beat + 0.08 for beat in BEATS]), beats=BEATS)
    by_frame = BUILT_IN["beat_alignment"](braking, reference_statistics())
    paid = np.flatnonzero(by_frame > 0.1)
    assert paid.tolist() == [int(beat * 30) for beat in BEATS]
    assert by_frame[: paid[0]].sum() == by_frame[paid[-1] + 1 :].sum() == 0  # chance is measured between the events


def test_frequent_braking_does_not_pay():
    everywhere = scene(dips(np.arange(0.1, 2.3, 0.2), depth=0.5), beats=BEATS)
    assert abs(say("beat_alignment", everywhere)) < 0.15


def test_trunk_and_feet_pay_up_to_a_limit():
    still, moving, wild = (scene(np.full(FRAMES + LEAD, level)) for level in (0.0, 0.5, 50.0))
    assert say("whole_body", still) == 0
    assert 0.2 < say("whole_body", moving) < say("whole_body", wild) <= 3
    assert say("whole_body", scene(STEADY, domain=0)) == 0
    assert say("whole_body", scene(np.full(FRAMES + LEAD, 0.2), domain=1)) > say("whole_body", scene(STEADY * 0.4))


def test_trunk_pays_for_turns_and_lean_alone():
    assert say("trunk", scene(STEADY, domain=0)) == 0
    stepping = scene(np.zeros(FRAMES + LEAD))
    ankle = stepping.skeleton.index("leftFoot")
    stepping.positions[:, ankle, 2] += 0.1 * np.sin(np.arange(FRAMES + LEAD))
    assert say("whole_body", stepping) > 0.2
    assert say("trunk", stepping) == pytest.approx(0, abs=1e-6)
    leaning = scene(np.zeros(FRAMES + LEAD))
    shoulders = leaning.skeleton.indices(("leftUpperArm", "rightUpperArm"))
    leaning.positions[:, shoulders, 2] += 0.1 * np.sin(np.arange(FRAMES + LEAD) / 5)[:, None]
    assert say("trunk", leaning) > 0.5


def test_trembling_costs_and_calm_is_free():
    assert say("smoothness", scene(STEADY), jerk=1e3) == 0
    assert say("smoothness", scene(STEADY, jitter=0.003), jerk=100.0) < -1


def test_sliding_feet_cost_and_standing_ones_are_free():
    still = scene(np.zeros(FRAMES + LEAD))
    sliding = scene(np.zeros(FRAMES + LEAD))
    sliding.positions[:, :, 0] += np.arange(FRAMES + LEAD)[:, None] / 30  # 1 m/s to the left
    assert say("planted_feet", still) == 0
    assert say("planted_feet", sliding) == pytest.approx(-3.0)  # 10 dm/s, but no worse than -3


def test_liveliness_is_free_near_the_truth_and_costs_beyond():
    assert say("liveliness", scene(dips((), level=0.5))) == 0
    assert say("liveliness", scene(dips((), level=0.05))) < -1
    assert say("liveliness", scene(dips((), level=3.0))) < -1
    assert say("liveliness", scene(dips((), level=0.0), domain=0)) == 0  # silence asks for none


def test_moving_hands_cost_in_silence_only():
    assert say("stillness", scene(STEADY, domain=0)) < -1
    assert say("stillness", scene(STEADY, domain=1)) == 0


def test_a_mix_adds_up_by_weight_and_keeps_times_apart_from_wholes():
    mix = RewardMix({"beats": 2.0, "liveliness": 0.5}, reference_statistics())
    made = [scene(dips(BEATS), beats=BEATS), scene(dips((), level=0.05))]
    found = mix(made)
    assert found.tokens.shape == (2, FRAMES // 4)
    np.testing.assert_allclose(found.tokens.sum(1), 2 * found.parts["beats"])
    np.testing.assert_allclose(found.whole, 0.5 * found.parts["liveliness"])
    np.testing.assert_allclose(found.total, found.tokens.sum(1) + found.whole)


def high_hands(made, own) -> float:
    return float(made.positions[:, made.skeleton.index("leftHand"), 1].mean())


def test_custom_reward_functions():
    mix = RewardMix({"high_hands": 1.0}, reference_statistics(), own={"high_hands": high_hands})
    assert mix([scene(STEADY)]).whole[0] > 1
    named = RewardMix({"lab.tests.align.moving_bodies:reach": 1.0}, reference_statistics())
    assert named([scene(STEADY)]).whole[0] > 1


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_reward_that_is_no_number_is_named(bad):
    mix = RewardMix({"mine": 1.0}, reference_statistics(), own={"mine": lambda made, own: bad})
    with pytest.raises(EchoAvatarError, match="reward 'mine' is (nan|inf) for continuation 0"):
        mix([scene(STEADY)])


def test_a_reward_of_the_wrong_length_is_named():
    mix = RewardMix({"mine": 1.0}, reference_statistics(), own={"mine": lambda made, own: np.zeros(5)})
    with pytest.raises(EchoAvatarError, match=r"reward 'mine' has shape \(5,\)"):
        mix([scene(STEADY)])


def test_weights_are_parsed_and_unknown_rewards_refused():
    assert parse_weights(["beats=1", "my.module:f=0.5"]) == {"beats": 1.0, "my.module:f": 0.5}
    with pytest.raises(EchoAvatarError, match="'beats' is not NAME=WEIGHT"):
        parse_weights(["beats"])
    with pytest.raises(EchoAvatarError, match="no reward 'beets'; there are beats"):
        RewardMix({"beets": 1.0}, reference_statistics())
    with pytest.raises(EchoAvatarError, match="cannot be imported"):
        RewardMix({"no_such_module:f": 1.0}, reference_statistics())


def test_strokes_that_come_earlier_than_the_truths_are_paid_for_where_they_are_asked_for():
    """A rise of speed at stresses, and one three frames before them."""
    own, events = reference_statistics(), (0.6, 1.2, 1.7)
    on_time, early = (
        scene(dips([event - lead for event in events], depth=-0.8), stresses=events, domain=1) for lead in (0, 0.1)
    )
    for made, better, worse in ((on_time, own, own.earlier(3)), (early, own.earlier(3), own)):
        paid, unpaid = (response(made, "stress", rule).sum() for rule in (better, worse))
        assert paid > unpaid + 0.2


def test_who_steps_or_parks_a_hand_by_the_face_while_talking_loses_and_who_dances_does_not():
    still, moving = (scene(np.full(FRAMES + LEAD, speed), domain=1) for speed in (0.0, 0.6))
    assert say("calm", still) == pytest.approx(0, abs=1e-6)
    assert say("calm", moving) < -1.5
    assert say("calm", scene(np.full(FRAMES + LEAD, 0.6), domain=2)) == 0
    down, up = still.positions.copy(), still.positions.copy()  # at rest the arms are stretched out
    for positions, sides in ((down, ("left", "right")), (up, ("right",))):
        positions[:, still.skeleton.indices([side + "Hand" for side in sides]), 1] -= 0.5
    assert say("returning", replace(still, positions=down)) == 0
    parked = replace(still, positions=up)
    assert say("returning", parked) == pytest.approx(-1, abs=0.01)
    assert say("returning", replace(parked, domain=np.full_like(parked.domain, 2))) == 0
