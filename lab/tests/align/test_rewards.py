"""Reward functions: what pays, what costs, what is free."""

import numpy as np
import pytest
from lab.tests.align.moving_bodies import FRAMES, LEAD, dips, reference_statistics, scene

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar_lab.align.rewards import (
    BUILT_IN,
    ReferenceStatistics,
    RewardMix,
    measure_reference_statistics,
    parse_weights,
)

BEATS = (0.5, 1.0, 1.5)


def test_levels_of_true_motion_are_measured_by_domain():
    own = measure_reference_statistics([scene(dips(()), domain=1), scene(dips((), level=1.0), domain=2)])
    assert own.speed[0] == 0
    assert own.speed[1] == pytest.approx(own.speed[2] / 2, rel=0.05)
    assert own.movement[1][3] == pytest.approx(own.movement[2][3] / 2, rel=0.05)
    assert own.scenes == 2


def test_files(tmp_path):
    own = reference_statistics()
    own.save(tmp_path / "y.json")
    assert ReferenceStatistics.load(tmp_path / "y.json") == own
    with pytest.raises(CheckpointError, match="holds no reference statistics"):
        ReferenceStatistics.load(tmp_path / "other.json")


STEADY = dips(())


def say(name: str, made, **changes) -> float:
    return float(np.sum(BUILT_IN[name](made, reference_statistics(**changes))))


def test_braking_on_the_beats_pays_and_braking_between_them_does_not():
    off = scene(dips((0.25, 0.75, 1.25, 1.75)), beats=BEATS)
    braking = scene(dips([beat + 0.08 for beat in BEATS]), beats=BEATS)  # BA_D's beat is the hardest braking
    assert say("beat_alignment", braking) > 0.3
    assert say("beat_alignment", off) < 0.05


def test_strokes_on_stresses_pay():
    ends = tuple(beat + 0.18 for beat in BEATS)
    assert say("stress_alignment", scene(dips(ends), stresses=BEATS)) > 0.1


def test_without_events_timing_says_nothing():
    for name in ("beat_alignment", "stress_alignment"):
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
    mix = RewardMix({"beat_alignment": 2.0, "liveliness": 0.5}, reference_statistics())
    made = [scene(dips(BEATS), beats=BEATS), scene(dips((), level=0.05))]
    found = mix(made)
    assert found.tokens.shape == (2, FRAMES // 4)
    np.testing.assert_allclose(found.tokens.sum(1), 2 * found.parts["beat_alignment"])
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
    assert parse_weights(["trunk=1", "my.module:f=0.5"]) == {"trunk": 1.0, "my.module:f": 0.5}
    with pytest.raises(EchoAvatarError, match="'trunk' is not NAME=WEIGHT"):
        parse_weights(["trunk"])
    with pytest.raises(EchoAvatarError, match="no reward 'drunk'; there are beat_alignment"):
        RewardMix({"drunk": 1.0}, reference_statistics())
    with pytest.raises(EchoAvatarError, match="cannot be imported"):
        RewardMix({"no_such_module:f": 1.0}, reference_statistics())
