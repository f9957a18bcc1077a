import numpy as np
import pytest
from lab.tests.evaluation.clips import MUSIC, SPEECH, clicks
from lab.tests.evaluation.metrics.swings import swing

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.evaluation.beat_rows import (
    ClipAudio,
    alignment_row,
    at_rate,
    dance_rows,
    gesture_rows,
    speed_around,
)
from echoavatar_lab.evaluation.metrics.beat_alignment import UPPER_BODY, gesture_beats

FRAMES = 300


def dancer(period_s: float) -> np.ndarray:
    """The whole body swings; it rests 0.3 s after the start and every half period, as the clicks sound."""
    ahead = swing(period_s, FRAMES / 30 + 2, HUMANOID.joints)
    first = round((period_s / 2 - 0.3) * 30)
    return ahead[first : first + FRAMES]


def heard(every_s: float, kind: int) -> ClipAudio:
    return ClipAudio(clicks(FRAMES, every_s), np.full(FRAMES, kind, np.uint8))


@pytest.mark.parametrize(("kind", "rows"), [(SPEECH, gesture_rows), (MUSIC, dance_rows)])
def test_motion_on_its_own_sound_beats_chance_and_motion_on_anothers_does_not(kind: int, rows) -> None:
    tempi = (0.8, 1.0, 1.3)
    sounds = [heard(tempo / 2, kind) for tempo in tempi]
    moves = [dancer(tempo) for tempo in tempi]
    shifted = [moves[1], moves[2], moves[0]]
    right, wrong = ({row.name: row for row in rows(sounds, made, moves)} for made in (moves, shifted))
    name = "ba_g_sharp" if kind == SPEECH else "ba_d_sharp"
    assert right[name].value > 0.6
    assert right[name].excess > 0.2
    assert wrong[name].excess < 0.1
    assert wrong[name].truth == right[name].value
    assert wrong[name].truth_chance == right[name].chance


def test_only_forms_of_what_is_heard_are_scored() -> None:
    speech, music = heard(0.5, SPEECH), heard(0.5, MUSIC)
    moves = [dancer(1.0)]
    assert dance_rows([speech], moves, moves) == []
    assert gesture_rows([music], moves, moves) == []
    assert [row.name for row in dance_rows([music], moves, moves)] == [
        "ba_d_paper",
        "ba_d_bailando",
        "ba_d_aist",
        "ba_d_sharp",
    ]


def test_events_count_only_where_they_fall_on_their_kind() -> None:
    half = np.full(FRAMES, SPEECH, np.uint8)
    half[150:] = MUSIC
    mixed = ClipAudio(clicks(FRAMES, 0.5), half)
    assert mixed.onsets(0).max() < 5
    assert mixed.beats().min() >= 5
    assert len(ClipAudio(clicks(FRAMES, 0.5), np.zeros(FRAMES, np.uint8)).onsets(0)) == 0


def test_a_clip_too_short_to_be_trimmed_is_left_out_of_those_forms_only() -> None:
    short = ClipAudio(clicks(120, 0.5), np.full(120, SPEECH, np.uint8))
    rows = {row.name: row for row in gesture_rows([short], [dancer(1.0)[:120]], [dancer(1.0)[:120]])}
    assert np.isnan(rows["ba_g_emage"].value)
    assert rows["ba_g_paper"].value > 0


def test_sixty_frames_a_second_pass_through_those_of_thirty() -> None:
    clip = dancer(1.0)
    fast = at_rate(clip, 60)
    assert len(fast) == 2 * FRAMES - 1
    np.testing.assert_allclose(fast[::2], clip, atol=1e-9)
    assert at_rate(clip, 30) is clip


def test_joints_of_another_rig_may_be_asked() -> None:
    """The same arms at other numbers score the same."""
    sounds, moves = [heard(0.4, SPEECH)], [dancer(0.8)]
    usual = gesture_rows(sounds, moves, moves)
    upper = HUMANOID.indices(UPPER_BODY)
    few = [move[:, upper] for move in moves]
    assert gesture_rows(sounds, few, few, upper=range(len(upper))) == usual


def test_chance_is_below_the_score_of_aligned_motion() -> None:
    periods = (0.9, 1.1, 1.3)
    events = [np.arange(1, 12) * period / 2 for period in periods]
    row = alignment_row("ba", events, [gesture_beats(swing(p)) for p in periods])
    assert row.value > 0.9
    assert row.chance < 0.6


def test_clips_without_events_are_left_out_of_both() -> None:
    """Two clips that share their beat, one without events: chance is what the two score with each other's."""
    events = [np.arange(1, 10) * 0.5, np.zeros(0), np.arange(1, 10) * 0.5]
    row = alignment_row("ba", events, [gesture_beats(swing(1.0))] * 3)
    assert row.value == pytest.approx(row.chance)
    assert row.value > 0.9
    nothing = alignment_row("ba", [np.zeros(0)], [[]])
    assert np.isnan([nothing.value, nothing.chance]).all()


def test_speed_around_events_tells_strokes_from_rests() -> None:
    """A point that moves at 1 m/s for a sixth of a second before each event, and rests otherwise."""
    frames, events = np.arange(600), np.arange(2, 18, 1.0)
    moves = ((frames % 30) >= 25).astype(float) / 30
    positions = np.zeros((600, 1, 3))
    positions[:, 0, 0] = np.cumsum(moves)
    before, after = (speed_around(positions, events, span) for span in ((-0.13, -0.05), (0.2, 0.5)))
    assert len(before) == 16
    assert before.mean() > 4
    assert after.max() < 0.1
