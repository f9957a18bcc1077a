import numpy as np
import pytest
from tests.engine.fakes import engine

from echoavatar.engine.listener import Listener
from echoavatar.engine.pipeline import Action, ActionLibrary

RATE = 24_000


def talk(seconds: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=int(seconds * RATE)).astype(np.float32) * 0.05


def quiet(seconds: float) -> np.ndarray:
    return talk(seconds, 9) * 0.002


def signs(sound: np.ndarray, block: int, seed: int = 1) -> list[tuple[str, float]]:
    listener, found = Listener(seed), []
    for start in range(0, len(sound), block):
        found += listener.hear(sound[start : start + block])
    return [(noticed.sign, round(noticed.sample / RATE, 2)) for noticed in found]


def test_a_turn_is_noticed_from_beginning_to_end_however_it_is_cut() -> None:
    sound = np.concatenate([quiet(1), talk(3), quiet(2)])
    found = signs(sound, 6_400)
    assert found == signs(sound, 137) == signs(sound, 10**9)
    assert found[0][0] == "begins"
    assert 1.0 < found[0][1] < 1.3
    assert found[-1] == ("ends", 5.0)


def test_nods_come_at_pauses_not_too_often_and_the_posture_returns() -> None:
    """Ten stretches of two seconds with half a second between them; a nod falls 0.3 s into a pause."""
    sound = np.concatenate([np.concatenate([talk(2, k), quiet(0.5)]) for k in range(10)])
    found = signs(sound, 6_400)
    nods = [at for sign, at in found if sign == "pause"]
    assert 2 <= len(nods) <= 9
    assert min(np.diff(nods)) >= 2.5
    assert all(abs(at % 2.5 - 2.3) < 0.05 for at in nods)
    after = [found[k + 1][0] for k, (sign, _) in enumerate(found[:-1]) if sign == "pause"]
    assert set(after) == {"begins"}


def at_level(sound: np.ndarray, decibels: float) -> np.ndarray:
    return np.asarray(sound * 10 ** (decibels / 20) / np.sqrt(np.mean(sound**2)), np.float32)


@pytest.mark.parametrize(
    ("room", "voice", "is_heard"), [(-80, -40, True), (-80, -50, False), (-40, -35, False), (-40, -28, True)]
)
def test_a_voice_is_heard_over_the_noise_of_a_room(room: float, voice: float, is_heard: bool) -> None:
    """A soft voice in a quiet room is heard and a murmur is not; a loud room takes ten decibels more."""
    noise = at_level(talk(22, 7), room)
    noise[20 * RATE :] += at_level(talk(2, 8), voice)
    found = [sign for sign, at in signs(noise, 6_400) if at > 20]
    assert (found[:1] == ["begins"]) == is_heard


@pytest.mark.parametrize("seed", range(4))
def test_a_short_answer_gets_no_nod_and_nods_keep_their_distance(seed: int) -> None:
    words = np.concatenate([np.concatenate([talk(0.5, k), quiet(0.5)]) for k in range(20)])
    assert "pause" not in [sign for sign, _ in signs(words, 6_400, seed)]
    phrases = np.concatenate([np.concatenate([talk(1.1, k), quiet(0.5)]) for k in range(40)])
    nods = [at for sign, at in signs(phrases, 6_400, seed) if sign == "pause"]
    assert min(np.diff(nods)) >= 2.5
    assert np.median(np.diff(nods)) < 6


def test_two_thirds_of_long_phrases_are_nodded_at() -> None:
    """Of 60 phrases of four seconds."""
    phrase = np.concatenate([talk(4), quiet(0.5)])
    nods = sum(sign == "pause" for seed in range(6) for sign, _ in signs(np.tile(phrase, 10), 6_400, seed))
    assert 0.55 < nods / 60 < 0.85


def test_the_posture_is_taken_again_when_the_nod_is_over() -> None:
    """The user goes on 0.4 s after the pause began: 1.6 s after the nod, not at once."""
    phrase = np.concatenate([talk(3), quiet(0.4)])
    found = signs(np.tile(phrase, 12), 480)
    waits = [found[at + 1][1] - when for at, (sign, when) in enumerate(found[:-1]) if sign == "pause"]
    assert waits
    assert 1.5 < min(waits) <= max(waits) < 1.8


def test_silence_and_steady_noise_are_nobody() -> None:
    assert signs(quiet(5), 4_000) == []
    assert [sign for sign, _ in signs(talk(60) * 0.3, 4_000)][-1] == "ends"


def test_a_session_listens_but_what_was_asked_for_comes_first() -> None:
    """Chunk by chunk: silence for the avatar while the user speaks; of its own posture nothing is told."""
    machine = engine()
    machine.actions = ActionLibrary({name: Action(name, (1, 2, 3, 4), (0, 1)) for name in ("listen", "nod", "wave")})
    session = machine.open_core(seed=1)
    session.listen(talk(1))
    assert session.is_listening
    running = session._actions.running(0)
    assert running is not None
    assert running.action.name == "listen"
    session.act("wave", hold_s=2.0)
    session.listen(np.concatenate([talk(3), quiet(0.5)]))
    running = session._actions.running(0)
    assert running is not None
    assert running.action.name == "wave"
    assert [status.name for status in session.take_statuses()] == ["wave"]
    session.listen(quiet(2))
    assert not session.is_listening


def test_a_listening_posture_ends_after_twenty_seconds() -> None:
    """Of a user who speaks on and on."""
    machine = engine()
    machine.actions = ActionLibrary({"listen": Action("listen", (1, 2, 3, 4), (0, 1))})
    session = machine.open_core(seed=1)
    session.listen(talk(1))
    assert [session._actions.running(chunk) is not None for chunk in (0, 72, 77)] == [True, True, False]


@pytest.mark.parametrize("is_told", [True, False])
def test_listening_ends_with_the_users_sound_without_a_silence(is_told: bool) -> None:
    """By word of the client, or after a second in which nothing came."""
    session = engine().open_core(seed=1)
    session.listen(talk(1))
    session.push(quiet(0.6), RATE)
    while session.take() is None:
        session.advance()
    assert session.is_listening
    if is_told:
        session.end_listening()
    else:
        session.push(quiet(1.6), RATE)
        while session.made < 6 * 6_400:
            session.advance()
            session.take()
    assert not session.is_listening
