import numpy as np
import pytest
from lab.tests.evaluation.clips import MUSIC, SPEECH, clicks
from lab.tests.evaluation.metrics.swings import swing

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.evaluation.metrics.gesture_alignment import UPPER_BODY
from echoavatar_lab.evaluation.score_beats import ClipAudio, at_rate, dance_rows, gesture_rows

pytest.importorskip("librosa", reason="the evaluate extra is not installed")
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
