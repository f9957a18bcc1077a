import json
from pathlib import Path

import numpy as np
import pytest
from tests.engine.fakes import FakePipeline

import echoavatar
from echoavatar.engine import Engine, Session
from echoavatar.engine.pipeline import ActionLibrary
from echoavatar.engine.words import _table, read_words
from echoavatar.errors import EchoAvatarError
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.timing import CHUNK, CHUNK_SECONDS, SAMPLE_RATE_HZ

LIBRARY = ActionLibrary.load(Path(echoavatar.__path__[0]) / "bundles" / "default", 1 << 16)
SAID = ("and", "you", "said", "that", "i", "think", "there", "are", "two", "small", "dogs")
TALK = [(word, 0.35 * at) for at, word in enumerate(SAID * 20)]


def open_session(
    seed: int = 0, rewind: int = 32, *, liveliness: float = 1.0, additions: frozenset[str] = FakePipeline.additions
) -> Session:
    pipeline = FakePipeline()
    pipeline.actions, pipeline.additions = LIBRARY, additions
    engine = Engine(pipeline, seats=1, rewind=rewind)  # type: ignore[arg-type]
    return engine.open(seed=seed, options=MotionOptions(liveliness=liveliness))


def sound(seconds: float) -> np.ndarray:
    return np.full(round(seconds * SAMPLE_RATE_HZ), 0.1, np.float32)


def motion(session: Session, seconds: float) -> np.ndarray:
    session.push(sound(seconds))
    return np.concatenate([chunk.rotations for chunk in session])


def gestures(session: Session) -> list[tuple[str, str, int, int]]:
    return [
        (act.concept, act.action.name, act.begin, act.end)
        for act in session.core._actions._actions
        if act.concept and act.length
    ]


def test_without_words_that_mean_something_motion_is_bit_equal():
    plain = motion(open_session(), 8)
    told = open_session()
    told.words([("dog", 1.0), ("zebra", 2.0)])
    assert np.array_equal(motion(told, 8), plain)
    shown = open_session()
    shown.words([("hello", 2.0)])
    moved = np.abs(motion(shown, 8) - plain).max(axis=(1, 2))
    assert moved.max() > 0.3
    assert moved[:30].max() == 0


@pytest.mark.parametrize("word", ["hello", "Thank you,", "THREE", "It\u2019s\u2026 huge!"])
def test_the_stroke_meets_the_word(word: str):
    session = open_session()
    session.words([(text, 3.0) for text in word.split()])
    motion(session, 8)
    ((_, name, begin, _),) = gestures(session)
    stroke = (begin + LIBRARY[name].hold[0]) * CHUNK_SECONDS
    assert abs(stroke - 3.0) <= CHUNK_SECONDS / 2 + 1e-6


def test_gestures_are_as_far_apart_as_those_of_people_and_drawn_by_the_seed():
    runs = []
    for seed in (0, 0, 1):
        session = open_session(seed)
        session.words(TALK)
        motion(session, 77)
        runs.append(gestures(session))
    assert runs[0] == runs[1] != runs[2]
    begins = np.array([begin for _, _, begin, _ in runs[0]])
    assert len(begins) > 4
    assert np.diff(begins).min() >= CHUNK.within(4)
    last: dict[str, int] = {}
    for concept, _, begin, _ in runs[0]:
        assert begin - last.get(concept, -1000) >= CHUNK.within(12)
        last[concept] = begin
    assert len({name for _, name, _, _ in runs[0]}) < sum(word == "you" for word, _ in TALK)


def test_a_quiet_speaker_hardly_gestures():
    session = open_session()
    session.set_manner(liveliness=0.0)
    session.words(TALK)
    motion(session, 30)
    assert gestures(session) == []


def test_where_both_hands_rest_in_speech_more_words_get_a_gesture():
    """The pipeline's hands rest always; only sessions that look for rests tell the model to be lively then."""
    counts = []
    for additions in (frozenset[str](), frozenset({"settling"})):
        sessions = [open_session(seed, liveliness=0.4, additions=additions) for seed in range(3)]
        for session in sessions:
            session.words(TALK)
            motion(session, 40)
        counts.append(sum(len(gestures(session)) for session in sessions))
    assert counts[1] > 1.2 * counts[0] > 0


def test_words_that_come_piece_by_piece_give_the_same():
    whole, pieces = open_session(), open_session()
    whole.words(TALK)
    motion(whole, 20)
    for second in range(20):
        first = second + 2 if second else 0  # words run two seconds ahead of the sound that is made
        pieces.words([(word, at - second) for word, at in TALK if first <= at < second + 3])
        motion(pieces, 1)
    assert [act for act in gestures(whole) if act[2] < 60] == [act for act in gestures(pieces) if act[2] < 60] != []


def test_what_a_tool_asks_for_goes_first():
    session = open_session()
    session.words([("hello", 2.0)])
    motion(session, 2.2)
    assert gestures(session)
    session.act("bow")
    later = motion(session, 3)
    assert len(later)
    ((_, _, begin, end),) = gestures(session)
    assert end - begin < 5
    busy = open_session()
    busy.act("bow", hold_s=5)
    busy.words([("hello", 2.0)])
    motion(busy, 4)
    assert gestures(busy) == []


def test_while_the_user_speaks_words_get_no_gesture():
    session = open_session()
    session.listen(np.random.default_rng(0).normal(0, 0.2, SAMPLE_RATE_HZ).astype(np.float32))
    assert session.status.is_listening
    session.words([("hello", 1.0)])
    motion(session, 1.5)
    assert gestures(session) == []


def test_a_gesture_is_no_action_that_was_asked_for():
    session = open_session()
    session.words([("hello", 2.0)])
    motion(session, 2)
    assert gestures(session)
    assert session.status.source == "speech"
    assert session.core.take_statuses() == []


def test_a_barge_in_drops_words_that_were_not_reached_and_ends_the_gesture():
    session = open_session()
    session.words([("hello", 2.0), ("dog", 3.0), ("three", 8.0)])
    motion(session, 10)
    assert len(gestures(session)) == 2
    session.clear(round(2.2 * SAMPLE_RATE_HZ))
    assert len(motion(session, 10)) > 290
    ((_, _, _, end),) = gestures(session)
    assert end <= 8
    session.words([("three", 2.0)])
    motion(session, 4)
    assert gestures(session)[-1][2] > CHUNK.within(11)


def test_chunks_that_are_made_again_get_the_same_gestures():
    once, again = open_session(), open_session()
    for session in (once, again):
        session.words(TALK)
        session.push(sound(20))
    first = [chunk.rotations for chunk in once]
    taken = iter(again)
    for _ in range(20):
        next(taken)
    again.core.report_played(5 * CHUNK.samples)
    again.set_manner(handedness=0.0)  # makes motion far ahead of the player again
    second = [chunk.rotations for chunk in again]
    assert gestures(once) == gestures(again) != []
    assert np.allclose(first[-10:], second[-10:], atol=1e-5)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ([("a", float("nan"))], "'a'"),
        ([("a", float("inf"))], "86,400"),
        ([("a", -1.0)], "'a'"),
        ([("a", 2.0, 1.0)], "'a'"),
        ([("a", 10**400)], "tuples"),
        ([("a", "b")], "tuples"),
        ([("a", 2.0), ("b", 1.0)], "send words in order"),
        ([("x" * 5_000_000, 0.0)], "5,000,000 letters"),
        ([("a", 0.0)] * 50_000, "50,001 words"),
        ([7], "tuples"),
    ],
)
def test_hostile_words_are_refused_by_name_and_leave_no_trace(words: list, named: str):
    session = open_session()
    session.words([("hello", 1.0)])
    with pytest.raises(EchoAvatarError, match=named):
        session.words(words)
    assert session.core._words._words == {0: [("hello", 1.0, None)]}


def test_many_utterances_and_words_at_one_time_cost_little():
    session = open_session()
    for number in range(1, 257):
        session.core.add_words([("you", 0.0)], number)
    with pytest.raises(EchoAvatarError, match="257 utterances"):
        session.core.add_words([("you", 0.0)], 257)
    session.core.interrupt()
    session.words([("you", 0.5)] * 20_000)
    assert len(motion(session, 2))


def test_every_word_of_the_table_has_one_concept_and_an_action_that_ships():
    words = [word for concept in _table()["en"].values() for word in concept["words"]]
    assert len(set(words)) == len(words)
    assert {name for concept in _table()["en"].values() for name in concept["actions"]} <= set(LIBRARY)
    assert all(len(word.split()) <= 4 and word == word.lower() for word in words)


def test_files_of_words(tmp_path: Path):
    (tmp_path / "talk.json").write_text('[{"text": "Hello", "start": 0.5, "end": 0.75}, {"text": "you", "start": 1}]')
    assert read_words(tmp_path / "talk.json") == [("Hello", 0.5, 0.75), ("you", 1, None)]
    (tmp_path / "talk.vtt").write_text("WEBVTT\n\n00:01.000 --> 00:02.000 align:start\n<c>Good</c> dogs\n")
    (tmp_path / "talk.srt").write_bytes(b"1\r\n00:00:01,000 --> 00:00:02,000\r\nGood dogs\r\n\r\n2\r\n")
    expected = [("Good", 1.0, 1.5), ("dogs", 1.5, 2.0)]
    assert read_words(tmp_path / "talk.vtt") == read_words(tmp_path / "talk.srt") == expected
    for encoding in ("utf-16", "utf-8-sig", "cp1252"):
        (tmp_path / "talk.srt").write_text("1\n00:00:01,000 --> 00:00:02,000\nein Café\n", encoding)
        assert [word.text for word in read_words(tmp_path / "talk.srt")] == ["ein", "Café"]
    (tmp_path / "slow.srt").write_text("1\n00:01:00,000 --> 00:01:12,000\nHello\n")
    assert read_words(tmp_path / "slow.srt") == [("Hello", 60, 72)], "captions tell seconds, however long"
    (tmp_path / "bad.json").write_text('{"text": 3}')
    (tmp_path / "number.json").write_text("5")
    (tmp_path / "bad.srt").write_text("Dialogue: 0,0:00:01.00,0:00:02.00,Good dogs")
    for name in ("bad.json", "number.json", "none.json", "bad.srt"):
        with pytest.raises(EchoAvatarError, match=name):
            read_words(tmp_path / name)


_TWO = ({"word": "Good", "start": 1.0, "end": 1.5}, {"word": "dogs", "start": 1.5, "end": 2.0})
RECOGNISERS = {
    "Whisper": {"text": "Good dogs", "segments": [{"text": "Good dogs", "start": 1.0, "end": 2.0}], "words": _TWO},
    "Whisper without words": {"text": "Good dogs", "segments": [{"id": 0, "text": " Good dogs", "start": 1, "end": 2}]},
    "WhisperX": {
        "segments": [{"text": "", "start": 1, "end": 2, "words": [one]} for one in _TWO],
        "word_segments": _TWO,
    },
    "Vosk": {"result": [{**one, "conf": 1.0} for one in _TWO], "text": "Good dogs"},
    "Deepgram": {"results": {"channels": [{"alternatives": [{"words": _TWO, "transcript": "Good dogs"}]}]}},
    "AssemblyAI": {
        "words": [{"text": one["word"], "start": 1000 * one["start"], "end": 1000 * one["end"]} for one in _TWO]
    },
    "Hugging Face": {"chunks": [{"text": one["word"], "timestamp": [one["start"], one["end"]]} for one in _TWO]},
    "the wrong order": _TWO[::-1],
    "a word without times": [*_TWO, {"word": "2014"}],
}


@pytest.mark.parametrize("program", RECOGNISERS)
def test_words_are_read_as_recognisers_write_them(program: str, tmp_path: Path, caplog: pytest.LogCaptureFixture):
    (tmp_path / "a.json").write_text(json.dumps(RECOGNISERS[program]))
    assert read_words(tmp_path / "a.json") == [("Good", 1.0, 1.5), ("dogs", 1.5, 2.0)]
    assert ("milliseconds" in caplog.text) == (program == "AssemblyAI")
