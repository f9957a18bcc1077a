import numpy as np

from echoavatar.models.face.idle import IdleFace, blink, frame_loudness, gaze
from echoavatar.motion.arkit import ARKIT_NAMES

SEEDS = np.arange(40)
FREE = IdleFace(np.zeros(52, np.bool_))
MINUTE = range(1800)
BLINK, BROW = ARKIT_NAMES.index("eyeBlinkLeft"), ARKIT_NAMES.index("browInnerUp")


def run(loudness: np.ndarray, face: IdleFace = FREE, pieces: int = 1) -> np.ndarray:
    state, active, parts = face.init_state(40), np.ones(40, np.bool_), []
    for part in np.split(loudness, pieces, 1):
        still = np.zeros((40, part.shape[1], 52), np.float32)
        parts.append(face.step(still, part, state, active, SEEDS))
    return np.concatenate(parts, 1)


def test_a_face_blinks_about_16_times_a_minute_and_not_in_step():
    lids = np.array([[blink(seed, frame) for frame in MINUTE] for seed in range(40)])
    starts = ((lids[:, 1:] > 0) & (lids[:, :-1] == 0)).sum(1)
    assert 12 < starts.mean() < 22
    assert lids.max() == 1
    assert (lids.max(0)[:100] > 0).mean() > 0.8  # somebody blinks at almost any time
    shut = lids > 0.5
    assert 0.02 < shut.mean() < 0.1


def test_some_blinks_are_left_out_and_some_are_double():
    """Of one every 3.3 s, about every seventh is left out, and every eighth is two."""
    lids = np.array([[blink(seed, frame) for frame in MINUTE] for seed in range(40)])
    is_there = lids.reshape(40, 18, 100).max(2) > 0
    assert 0.08 < (~is_there).mean() < 0.22
    starts = ((lids[:, 1:] > 0) & (lids[:, :-1] == 0)).sum()
    assert 0.07 < starts / is_there.sum() - 1 < 0.18


def test_gaze_is_small_mostly_at_home_and_held_between_jumps():
    yaw, pitch = np.moveaxis([[gaze(seed, frame) for frame in MINUTE] for seed in range(40)], 2, 0)
    assert 0.2 < np.abs(yaw).max() <= 0.25
    assert 0.11 < np.abs(pitch).max() <= 0.14
    assert 0.4 < ((yaw == 0) & (pitch == 0)).mean() < 0.7
    moves = (yaw[:, 1:] != yaw[:, :-1]) | (pitch[:, 1:] != pitch[:, :-1])
    jumps = moves[:, 1:] & ~moves[:, :-1]
    assert 20 < jumps.sum(1).mean() < 34  # a minute
    assert 2 < moves.sum() / jumps.sum() < 4  # frames, a tenth of a second


def test_it_lives_in_silence_and_the_mouth_is_still():
    curves = run(np.zeros((40, 1800)))
    moved = {name for i, name in enumerate(ARKIT_NAMES) if np.ptp(curves[..., i]) > 0}
    assert {"eyeBlinkLeft", "eyeLookInLeft", "browInnerUp"} <= moved
    assert not any(name.startswith(("mouth", "jaw", "tongue", "cheek")) for name in moved)


def test_brows_rise_on_loud_onsets():
    loudness = np.full((40, 300), 0.4)
    loudness[:, 150:160] = 0.9
    brows = run(loudness)[..., BROW].mean(0)
    assert brows[152:162].max() > brows[100:150].max() + 0.1
    assert brows[250:].mean() < brows[152:162].max() - 0.1


def test_brows_go_up_in_two_frames_come_down_in_a_third_of_a_second_and_get_used_to_it():
    """By how much a step of 0.5 in loudness raises them: while it lasts for a third of a second, and for good."""
    calm, burst = np.full((40, 300), 0.4), np.full((40, 300), 0.4)
    burst[:, 150:160] = 0.9
    louder = np.where(np.arange(300) < 150, calm, 0.9)
    burst, louder = ((run(loudness) - run(calm))[..., BROW].mean(0) for loudness in (burst, louder))
    assert 0.15 < burst.max() < 0.35
    assert 0.1 < burst[150] / burst.max() < 0.4
    assert burst[152] > 0.7 * burst.max()
    assert 0.25 < burst[167] / burst.max() < 0.65
    assert 0.3 < louder[180] / louder.max() < 0.85
    assert louder[230:].max() < 0.1 * louder.max()


def test_any_chunking_and_any_neighbour_give_the_same():
    loudness = np.random.default_rng(0).random((40, 160))
    whole = run(loudness)
    np.testing.assert_array_equal(run(loudness, pieces=20), whole)
    loudness[1:] = 0
    np.testing.assert_array_equal(run(loudness, pieces=20)[0], whole[0])


def test_idle_rows_keep_their_state_and_reset_rows_begin_again():
    state, active = FREE.init_state(40), np.arange(40) > 0
    FREE.step(np.zeros((40, 8, 52), np.float32), np.random.default_rng(1).random((40, 8)), state, active, SEEDS)
    assert not state.seen[0]
    assert not state.brows[0].any()
    assert state.seen[1] == 8
    assert state.brows[1].any()
    state.reset(np.ones(40, np.bool_))
    assert not state.seen.any()
    assert not state.brows.any()


def test_what_the_model_moves_is_left_alone():
    moving = np.arange(52) == BLINK
    curves = run(np.zeros((40, 400)), IdleFace(moving))
    assert curves[..., BLINK].max() == 0
    assert curves[..., ARKIT_NAMES.index("eyeBlinkRight")].max() == 1


def test_loudness_is_of_each_frame():
    """A full-scale square wave is 1; one of a thousandth (-60 dB) and silence are 0; -30 dB is one half."""
    audio = np.repeat(np.float32([[1.0, 10**-1.5, 0.0]]), 800, 1)
    np.testing.assert_allclose(frame_loudness(audio), [[1.0, 0.5, 0.0]], atol=1e-5)
