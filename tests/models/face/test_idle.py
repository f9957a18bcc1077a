import numpy as np
import torch

from echoavatar.models.face.idle import IdleFace, blinks, frame_loudness, gaze
from echoavatar.motion.arkit import ARKIT_NAMES

SEEDS = torch.arange(40)
FREE = IdleFace(torch.zeros(52))
MINUTE = torch.arange(1800).expand(40, -1)
BLINK, BROW = ARKIT_NAMES.index("eyeBlinkLeft"), ARKIT_NAMES.index("browInnerUp")


def run(sizes: list[int], loudness: torch.Tensor, face: IdleFace = FREE) -> torch.Tensor:
    state, active, parts = face.init_state(40), torch.ones(40, dtype=torch.bool), []
    for part in loudness.split(sizes, 1):
        still = torch.zeros(40, part.shape[1], 52)
        parts.append(face.step(still, part, state, active, SEEDS))
    return torch.cat(parts, 1)


def test_a_face_blinks_about_16_times_a_minute_and_not_in_step():
    lids = blinks(SEEDS, MINUTE)
    starts = ((lids[:, 1:] > 0) & (lids[:, :-1] == 0)).sum(1).double()
    assert 12 < starts.mean() < 22
    assert lids.max() == 1
    assert (lids.max(0).values[:100] > 0).double().mean() > 0.8  # somebody blinks at almost any time
    shut = lids > 0.5
    assert 0.02 < shut.double().mean() < 0.1


def test_some_blinks_are_left_out_and_some_are_double():
    """Of one every 3.3 s, about every seventh is left out, and every eighth is two."""
    lids = blinks(SEEDS, MINUTE)
    is_there = lids.unflatten(1, (18, 100)).amax(2) > 0
    assert 0.08 < (~is_there).double().mean() < 0.22
    starts = ((lids[:, 1:] > 0) & (lids[:, :-1] == 0)).sum()
    assert 0.07 < starts / is_there.sum() - 1 < 0.18


def test_gaze_is_small_mostly_at_home_and_held_between_jumps():
    yaw, pitch = gaze(SEEDS, MINUTE)
    assert 0.2 < yaw.abs().max() <= 0.25
    assert 0.11 < pitch.abs().max() <= 0.14
    assert 0.4 < ((yaw == 0) & (pitch == 0)).double().mean() < 0.7
    moves = (yaw[:, 1:] != yaw[:, :-1]) | (pitch[:, 1:] != pitch[:, :-1])
    jumps = moves[:, 1:] & ~moves[:, :-1]
    assert 20 < jumps.sum(1).double().mean() < 34  # a minute
    assert 2 < moves.sum() / jumps.sum() < 4  # frames, a tenth of a second


def test_it_lives_in_silence_and_the_mouth_is_still():
    curves = run([1800], torch.zeros(40, 1800)).numpy()
    moved = {name for i, name in enumerate(ARKIT_NAMES) if np.ptp(curves[..., i]) > 0}
    assert {"eyeBlinkLeft", "eyeLookInLeft", "browInnerUp"} <= moved
    assert not any(name.startswith(("mouth", "jaw", "tongue", "cheek")) for name in moved)


def test_brows_rise_on_loud_onsets():
    loudness = torch.full((40, 300), 0.4)
    loudness[:, 150:160] = 0.9
    brows = run([300], loudness)[..., BROW].mean(0)
    assert brows[152:162].max() > brows[100:150].max() + 0.1
    assert brows[250:].mean() < brows[152:162].max() - 0.1


def test_brows_go_up_in_two_frames_come_down_in_a_third_of_a_second_and_get_used_to_it():
    """By how much a step of 0.5 in loudness raises them: while it lasts for a third of a second, and for good."""
    calm, burst = torch.full((40, 300), 0.4), torch.full((40, 300), 0.4)
    burst[:, 150:160] = 0.9
    louder = torch.where(torch.arange(300) < 150, calm, 0.9)
    burst, louder = ((run([300], loudness) - run([300], calm))[..., BROW].mean(0) for loudness in (burst, louder))
    assert 0.15 < burst.max() < 0.35
    assert 0.1 < burst[150] / burst.max() < 0.4
    assert burst[152] > 0.7 * burst.max()
    assert 0.25 < burst[167] / burst.max() < 0.65
    assert 0.3 < louder[180] / louder.max() < 0.85
    assert louder[230:].max() < 0.1 * louder.max()


def test_any_chunking_and_any_neighbour_give_the_same():
    loudness = torch.rand(40, 160, generator=torch.Generator().manual_seed(0))
    whole = run([160], loudness)
    assert torch.equal(run([8] * 20, loudness), whole)
    loudness[1:] = 0
    assert torch.equal(run([8] * 20, loudness)[0], whole[0])


def test_idle_rows_keep_their_state_and_reset_rows_begin_again():
    state, active = FREE.init_state(40), torch.arange(40) > 0
    FREE.step(torch.zeros(40, 8, 52), torch.rand(40, 8), state, active, SEEDS)
    assert [tensor[0].item() for tensor in state.arrays()] == [0, 0, 0, 0]
    assert state.seen[1] == 8
    state.reset(torch.ones(40, dtype=torch.bool))
    assert all(not tensor.any() for tensor in state.arrays())


def test_what_the_model_moves_is_left_alone():
    moving = torch.zeros(52)
    moving[BLINK] = 1
    curves = run([400], torch.zeros(40, 400), IdleFace(moving))
    assert curves[..., BLINK].max() == 0
    assert curves[..., ARKIT_NAMES.index("eyeBlinkRight")].max() == 1


def test_loudness_is_of_each_frame():
    """A full-scale square wave is 1; one of a thousandth (-60 dB) and silence are 0; -30 dB is one half."""
    audio = torch.cat([torch.ones(1, 800), torch.full((1, 800), 10**-1.5), torch.zeros(1, 800)], 1)
    torch.testing.assert_close(frame_loudness(audio), torch.tensor([[1.0, 0.5, 0.0]]), atol=1e-5, rtol=0)
