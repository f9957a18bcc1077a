import numpy as np
import pytest

from echoavatar.engine.inbox import Inbox
from echoavatar.errors import EchoAvatarError, InboxError


def test_speech_comes_out_as_it_went_in_and_silence_follows_it() -> None:
    inbox, sound = Inbox(), np.arange(9_000, dtype=np.float32) / 9_000
    inbox.push(sound, 24_000)
    assert inbox.has_chunk
    first, second, third = inbox.take(), inbox.take(), inbox.take()
    np.testing.assert_array_equal(first.speech, sound[:6_400])
    np.testing.assert_array_equal(second.speech[:2_600], sound[6_400:])
    assert not second.speech[2_600:].any()
    assert (first.voiced, second.voiced, third.voiced) == (True, True, False)
    assert first.music is None


def test_what_is_given_back_comes_again_and_a_cut_drops_the_rest() -> None:
    inbox, sound = Inbox(), np.arange(20_000, dtype=np.float32)
    inbox.push(sound / 20_000, 24_000)
    taken = [inbox.take().speech for _ in range(2)]
    inbox.give_back(np.concatenate(taken), None)
    np.testing.assert_array_equal(inbox.take().speech, taken[0])
    inbox.give_back(taken[0], 7_000)
    inbox.push(np.full(8_000, 0.5, np.float32), 24_000)
    whole = np.concatenate([inbox.take().speech, inbox.take().speech])
    np.testing.assert_array_equal(whole[:7_000], (sound / 20_000)[:7_000])
    assert (whole[7_000:] == 0.5).all()


def test_stalling_delivers_what_the_resampler_holds_and_the_length_stays_exact() -> None:
    """1,000 samples at 8 kHz are 3,000 at 24 kHz; the filter's delay must not come out behind the silence."""
    inbox = Inbox()
    inbox.push(np.ones(1_000, np.float32), 8_000)
    inbox.stall()
    speech = inbox.take().speech
    assert abs(speech[2_900] - 1) < 0.1
    assert not speech[3_000:].any()
    assert not inbox.has_chunk


def test_too_much_and_too_late_are_refused() -> None:
    inbox = Inbox()
    with pytest.raises(InboxError, match="600 s of audio are waiting"):
        inbox.push(np.zeros(601 * 24_000, np.float32), 24_000)
    inbox.finish()
    with pytest.raises(EchoAvatarError, match="finished"):
        inbox.push(np.zeros(1, np.float32), 24_000)
