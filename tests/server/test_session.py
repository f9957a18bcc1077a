"""What one session tells its clients, chunk by chunk."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.server.rooms import Room, Told

from echoavatar.engine import load
from echoavatar.models.generator.manner import MANNER
from echoavatar.server.session import ServerSession, TrackWatch, answer
from echoavatar.server.settings import ServerSettings
from echoavatar.timing import CHUNK_SAMPLES
from echoavatar.wire.blobs import pack_audio, unpack_pose
from echoavatar.wire.codec import ProtocolError, encode
from echoavatar.wire.messages import (
    ActionStatus,
    Audio,
    End,
    Flush,
    Hello,
    Interrupt,
    Motion,
    Played,
    Sound,
    State,
    Word,
    Words,
)


def test_silence_is_made_just_in_time_and_goes_on() -> None:
    room = Room()
    room.go(10.0)
    ends = [message.at for message in room.box.of(Motion)]
    assert ends == list(range(0, ends[-1] + 1, CHUNK_SAMPLES))
    assert 10.1 <= room.session.end / 24_000 <= 10.6
    assert not room.sound().any()
    assert {message.state for message in room.box.of(Motion)} == {"idle"}


def test_a_player_never_waits_for_motion_that_the_network_delays_by_150_ms() -> None:
    """Messages arrive in order, the first at once, others up to 150 ms late; the player begins with the first."""
    room, random, arrived = Room(), np.random.default_rng(0), dict[int, float]()
    last = 0.0
    while room.now < 30:
        room.beat()
        for motion in room.box.of(Motion)[len(arrived) :]:
            last = max(last, room.now + (random.uniform(0.0, 0.15) if arrived else 0.0))
            arrived[motion.at] = last
        assert room.session.deadline is not None
        room.now = room.session.deadline
    spare = [arrived[0] + at / 24_000 - when for at, when in arrived.items()]
    assert len(spare) > 100
    assert min(spare) >= 0


def test_speech_that_comes_at_once_is_made_ahead_within_the_bound() -> None:
    room = Room()
    room.speak(1, 30.0)
    room.beat()
    assert 2.0 <= room.session.end / 24_000 <= 2.0 + CHUNK_SAMPLES / 24_000
    room.go(5.0)
    assert room.session.end / 24_000 - 5.0 <= 2.3


def test_sound_comes_back_as_it_was_sent_and_its_end_is_told() -> None:
    room = Room()
    room.go(1.0)
    room.speak(1, 1.0, level=0.25)
    room.session.finish(End(seg=1))
    room.go(3.0)
    sound = room.sound()
    spoken = np.flatnonzero(sound)
    assert len(spoken) == 24_000
    assert spoken[-1] - spoken[0] == 23_999
    (done,) = [state for state in room.box.of(State) if state.finished == 1][:1]
    assert done.at == spoken[-1] + 1
    assert room.box.of(State)[-1].state == "idle"


def test_motion_goes_before_its_sound() -> None:
    room = Room()
    room.go(2.0)
    kinds = [type(message) for message in room.box.told if isinstance(message, Motion | Sound)]
    assert kinds == [Motion, Sound] * (len(kinds) // 2)


def test_a_source_slower_than_real_time_is_filled_with_silence() -> None:
    """A tenth of a second of sound arrives every 0.2 s."""
    room = Room()
    for k in range(30):
        room.speak(1, 0.1, start=2_400 * k)
        room.go(0.2)
    room.session.finish(End(seg=1))
    room.go(2.0)
    assert np.count_nonzero(room.sound()) == 72_000
    assert room.session.end / 24_000 >= 8.0 - 0.1


def test_without_a_player_the_clock_stands_still() -> None:
    room = Room()
    room.go(1.0)
    room.session.leave(room.box)
    end = room.session.end
    room.go(20.0)
    assert room.session.end == end
    room.session.join(room.box, received=None)
    room.go(1.0)
    assert end < room.session.end <= end + 1.5 * 24_000


def test_a_viewer_who_comes_late_is_shown_what_is_being_played() -> None:
    room = Room()
    room.speak(1, 3.0)
    room.go(1.0)
    late = Told()
    at = room.session.first_for(None)
    room.session.join(late, received=None)
    assert late.of(Motion)[0].at == at
    assert at <= room.session.place < at + CHUNK_SAMPLES
    assert late.of(Motion)[-1].at == room.session.end - CHUNK_SAMPLES


def test_a_resuming_client_is_sent_what_it_missed() -> None:
    room = Room()
    room.speak(1, 3.0)
    room.go(1.0)
    back = Told()
    room.session.join(back, received=3 * CHUNK_SAMPLES)
    assert back.of(Motion)[0].at == 3 * CHUNK_SAMPLES


def test_a_client_that_was_away_for_six_seconds_misses_nothing() -> None:
    room = Room()
    room.go(2.0)
    received = room.session.end
    room.go(6.0)
    back = Told()
    room.session.join(back, received=received)
    assert [motion.at for motion in back.of(Motion)] == list(range(received, room.session.end, CHUNK_SAMPLES))


def test_a_client_that_missed_a_flush_is_told_it_and_sent_all_that_follows() -> None:
    """The connection broke with the interruption, so the client holds motion that was taken back."""
    room = Room()
    room.speak(1, 3.0)
    room.go(1.0)
    received, epoch = room.session.end, room.session.epoch
    room.session.interrupt(Interrupt(heard=CHUNK_SAMPLES + 1_600))
    room.go(0.5)
    flush, back = room.session.missed_flush(epoch), Told()
    assert flush == room.box.of(Flush)[-1]
    assert room.session.missed_flush(room.session.epoch) is None
    room.session.join(back, received=min(received, flush.at))
    assert back.of(Motion)[0].at <= flush.at
    assert {message.epoch for message in back.told if isinstance(message, Motion | Sound)} == {flush.epoch}


@settings(max_examples=12, deadline=None)
@given(before=st.floats(0, 1.5), share=st.floats(0, 1), length=st.floats(0.3, 4.0), after=st.floats(0.0, 0.5))
def test_nothing_after_an_interruption_stems_from_unheard_sound(
    before: float, share: float, length: float, after: float
) -> None:
    """The hips' height is the sum of the sound heard: after `flush` it must be that of the heard part alone."""
    room = Room()
    room.go(before)
    room.speak(1, length, level=0.5)
    room.go(after)
    played = room.session.place
    heard = round(played + share * (room.session.end - played))
    first = next((m.at for m in room.box.of(Sound) if m.seg == 1), None)
    room.session.interrupt(Interrupt(heard=heard))
    (flush,) = room.box.of(Flush)
    assert heard <= flush.at < heard + 800
    told = len(room.box.told)
    room.speak(1, 1.0, start=round(length * 24_000))  # still on its way when we interrupted
    room.go(1.0)
    expected = 0 if first is None else max(0, heard - first)
    if flush.seg:
        assert (flush.seg, flush.heard) == (1, min(expected, round(length * 24_000)))
    later = [message for message in room.box.told[told:] if isinstance(message, Motion)]
    assert later[0].at == flush.at
    assert {message.epoch for message in later} == {flush.epoch}
    height = unpack_pose(later[-1]).root[-1, 1]
    assert height == pytest.approx(0.5e-5 * np.count_nonzero(room.sound()[:heard]), abs=2e-4)
    assert np.count_nonzero(room.sound()[flush.at :]) == 0
    assert room.session.place >= heard


def test_an_interruption_is_answered_before_anything_new_is_needed() -> None:
    room = Room()
    room.speak(1, 5.0)
    room.go(1.0)
    room.session.interrupt(Interrupt())
    told = len(room.box.told)
    room.beat()
    assert any(isinstance(message, Motion) for message in room.box.told[told:])


def test_an_utterance_after_an_interruption_is_said() -> None:
    room = Room()
    room.speak(1, 5.0)
    room.go(1.0)
    for _ in range(3):
        room.session.interrupt(Interrupt())
    room.speak(2, 1.0, level=0.5)
    room.session.finish(End(seg=2))
    room.go(3.0)
    assert np.count_nonzero(room.sound() > 0.4) == 24_000
    assert room.box.of(State)[-1].finished == 2


def test_an_action_during_speech_made_ahead_replaces_what_was_not_shown() -> None:
    room = Room()
    room.speak(1, 8.0)
    room.session.finish(End(seg=1))
    room.go(1.0)
    room.session.act("wave", id="a")
    room.go(8.0)
    statuses = [(s.status, s.at) for s in room.box.of(ActionStatus)]
    assert [status for status, _ in statuses] == ["accepted", "started", "done"]
    assert statuses[1][1] / 24_000 - 1.0 < 0.7
    sound = room.sound()
    assert np.count_nonzero(sound) == 8 * 24_000  # no sound is lost or said twice
    assert np.flatnonzero(sound)[-1] - np.flatnonzero(sound)[0] == 8 * 24_000 - 1
    assert room.box.of(State)[-1].finished == 1


def test_an_unknown_action_is_answered_with_the_list() -> None:
    room = Room()
    room.session.act("fly", id="a")
    (status,) = room.box.of(ActionStatus)
    assert (status.id, status.status, status.choices) == ("a", "rejected", ("wave", "bow"))


def test_a_manner_holds_for_what_is_not_shown_yet() -> None:
    room = Room()
    room.speak(1, 8.0)
    room.go(1.0)
    room.session.set_manner(handedness=0.9)
    plan = room.session.core.begin_chunk(0)
    assert plan.manner[MANNER.index("right")] == pytest.approx(0.9)


def test_words_get_a_gesture_and_bad_ones_an_error_that_is_not_fatal() -> None:
    room = Room()
    room.session.set_manner(liveliness=1.0)
    room.session.add_words(Words(seg=1, words=(Word(text="Bye", start=3.0),)))
    with pytest.raises(ProtocolError, match="send words in order") as refused:
        room.session.add_words(Words(seg=1, words=(Word(text="a", start=2.0),)))
    assert not refused.value.fatal
    room.speak(1, 8.0)
    room.go(5.0)
    actions = room.session.core._actions
    assert [act.concept for act in actions._actions] == ["bye"]
    assert room.box.of(ActionStatus) == []
    assert {state.state for state in room.box.of(State)} <= {"idle", "speaking"}


def test_music_is_heard_danced_to_and_ends() -> None:
    room = Room()
    room.go(0.5)
    room.session.play("Tune", np.full(48_000, 0.2, np.float32), id="m")
    room.go(5.0)
    assert [s.status for s in room.box.of(ActionStatus)] == ["accepted", "started", "done"]
    assert np.count_nonzero(room.sound()) == 48_000
    assert "dancing" in {message.state for message in room.box.of(Motion)}


def test_a_song_that_a_client_sends_is_danced_to(monkeypatch: pytest.MonkeyPatch) -> None:
    room = Room()
    monkeypatch.setattr(room.session.core, "dances_at", lambda sample: True)
    room.speak(1, 2.0)
    room.session.finish(End(seg=1))
    room.go(3.0)
    assert {message.state for message in room.box.of(Motion)} == {"dancing", "idle"}
    assert 1 in {state.seg for state in room.box.of(State) if state.state == "dancing"}
    assert room.box.of(State)[-1].finished == 1


def test_speech_over_music_is_whole_and_known_by_its_number() -> None:
    room = Room()
    room.session.play("Tune", np.full(20 * 24_000, 0.01, np.float32), id="m")
    room.go(2.0)
    room.speak(1, 1.0, level=0.5)
    room.session.finish(End(seg=1))
    room.go(4.0)
    loud = np.flatnonzero(room.sound() > 0.3)
    assert len(loud) == 24_000
    spoken = {at // CHUNK_SAMPLES for at in loud}
    assert {chunk for chunk, seg in room.segs().items() if seg == 1} == spoken
    room.session.stop_music(id="n")
    room.go(3.0)
    assert room.box.of(ActionStatus)[-1].id == "m"


def test_the_avatar_listens_to_the_user_without_saying_it() -> None:
    room = Room()
    room.go(0.5)
    voice = 0.3 * np.sin(np.arange(24_000) / 20) * (np.arange(24_000) % 6_000 < 4_000)
    room.session.hear(Audio(seg=1, start=0, pcm=pack_audio(voice.astype(np.float32)), speaker="user"))
    room.go(0.5)
    assert room.box.of(Motion)[-1].state == "listening"
    room.session.finish(End(seg=1, speaker="user"))
    room.go(0.5)
    assert room.box.of(Motion)[-1].state == "idle"
    assert not room.sound().any()


def test_a_report_from_before_a_flush_says_nothing() -> None:
    room = Room()
    room.speak(1, 5.0)
    room.go(1.0)
    room.session.interrupt(Interrupt(heard=12_000))
    room.session.source = room.box
    room.session.played(Played(at=40_000, epoch=0), room.box)
    assert room.session.place == 12_000
    room.session.played(Played(at=12_100, epoch=1), room.box)
    assert room.session.place <= 12_100


def test_a_viewer_that_says_it_stands_still_or_is_far_ahead_moves_nothing() -> None:
    room, viewer = Room(), Told()
    room.session.source = room.box
    room.session.join(viewer, received=None)
    for _ in range(30):
        room.session.played(Played(at=0, underruns=7), viewer)
        room.go(0.1)
    assert room.session.end > 3.0 * 24_000
    assert room.session.underruns == 7
    before = room.session.place
    room.session.played(Played(at=room.session.end), viewer)
    assert room.session.place == before


def test_when_a_source_that_reported_is_gone_its_viewers_watch_on() -> None:
    room, viewer = Room(), Told()
    room.session.source = room.box
    room.session.join(viewer, received=None)
    room.go(1.0)
    room.session.played(Played(at=12_000), room.box)
    room.session.leave(room.box)
    end = room.session.end
    room.go(3.0)
    assert room.session.end > end + 2.0 * 24_000


def test_an_interruption_that_names_a_sample_of_long_ago_does_not_hold_the_session() -> None:
    room = Room()
    room.go(10.0)
    room.session.interrupt(Interrupt(heard=0))
    assert room.session.place > 4 * 24_000
    end = room.session.end
    room.go(1.5)
    assert room.session.end > end + 24_000


def test_a_flood_is_refused_and_changes_nothing() -> None:
    room = Room(inbox_seconds=2.0)
    room.speak(1, 2.0)
    with pytest.raises(ProtocolError, match="waiting"):
        room.speak(1, 2.0, start=48_000)
    room.go(4.0)
    assert np.count_nonzero(room.sound()) == 48_000


def test_what_is_kept_does_not_grow() -> None:
    room = Room()
    room.go(30.0, step=0.1)
    assert len(room.session.sent) < 40
    assert len(room.session.pacer._scheduled) < 40
    assert len(room.session.core._queue._spans) < 80


def test_early_sessions_go_with_one_that_is_due() -> None:
    """A step of the engine moves everyone; one who is not due yet goes along."""
    room = Room()
    room.go(3.0)
    while room.session.keep_pace():
        room.beat()
    end = room.session.end
    room.beat()
    assert room.session.end == end
    room.session.keep_pace(early=True)
    while room.engine.tick():
        pass
    room.session.collect()
    assert room.session.end == end + CHUNK_SAMPLES


@pytest.fixture(scope="module")
def default_room() -> Room:
    """The shipped bundle in the place of the body of twenty lines."""
    room = Room()
    room.engine = load("default")
    room.session = ServerSession(
        room.engine.open_core(seed=1, is_paced=True),
        name="s",
        key="k",
        hello=Hello(),
        settings=ServerSettings(),
        clock=lambda: room.now,
    )
    room.session.join(room.box, received=None)
    return room


def test_the_default_bundle_speaks_is_interrupted_and_stays_small(default_room: Room) -> None:
    room = default_room
    noise = 0.1 * np.random.default_rng(0).standard_normal(9_600)
    room.session.hear(Audio(seg=1, start=0, pcm=pack_audio(noise.astype(np.float32))))
    room.beat()
    room.session.interrupt(Interrupt(heard=room.session.end - 4_000))
    room.beat()
    motions = room.box.of(Motion)
    assert {motion.epoch for motion in motions} == {0, 1}
    assert all(len(encode(motion)) < 4_200 for motion in motions)
    poses = [unpack_pose(motion) for motion in motions]
    turns = np.concatenate([pose.rotations for pose in poses])
    np.testing.assert_allclose(np.linalg.norm(turns, axis=-1), 1, atol=1e-3)
    assert 0.5 < np.concatenate([pose.root for pose in poses])[:, 1].mean() < 1.5


def test_a_track_is_followed_from_the_asking_to_its_end() -> None:
    watch = TrackWatch()
    told: list[ActionStatus] = watch.follow(0, has_music=False)
    told += watch.ask("a", "Evening", 0)
    told += watch.follow(6_400, has_music=False)  # made before it was asked for
    for at in (12_800, 19_200):
        told += watch.follow(at, has_music=True)
    assert watch.title == "Evening"
    told += watch.ask("b", "Morning", 25_600)
    told += watch.follow(25_600, has_music=True)
    told += watch.follow(32_000, has_music=False)
    assert [(s.id, s.status, s.at) for s in told] == [
        ("a", "accepted", 0),
        ("a", "started", 12_800),
        ("a", "done", 25_600),
        ("b", "accepted", 25_600),
        ("b", "started", 25_600),
        ("b", "done", 32_000),
    ]
    assert watch.title == ""


@pytest.mark.parametrize("failing", ["put", "forget_after"])
def test_a_listener_that_cannot_be_told_anything_harms_no_other(failing: str) -> None:
    room = Room()
    broken, other = Told(), Told()
    setattr(broken, failing, lambda _: 1 / 0)
    room.session.listeners.insert(0, broken)
    room.session.join(other, received=None)
    room.speak(1, 2.0)
    room.go(1.0)
    room.session.interrupt(Interrupt())
    room.go(1.0)
    assert room.session.listeners == [room.box, other]
    assert room.box.told == other.told
    assert {type(message) for message in other.told} >= {Motion, Sound, State, Flush}
    assert broken.error is not None


def test_a_rejection_names_the_choices() -> None:
    assert answer("x", "fly", "rejected", 0, reason="no", choices=("wave",)).choices == ("wave",)
