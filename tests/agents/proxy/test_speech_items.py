"""The items of speech: their chunks, and their samples on the avatar's clock."""

import numpy as np

from echoavatar.agents.proxy.speech_items import SpeechItem, SpeechItems
from echoavatar.agents.voice_formats import Decoder
from echoavatar.timing import CHUNK_SAMPLES, ChunkSize


def voice(item: str = "a", begun: float = 0.0) -> SpeechItem:
    return SpeechItem(item, "r", 0, 0, Decoder(), begun=begun)


def test_only_whole_chunks_are_made_and_the_last_is_padded_with_silence() -> None:
    one = voice()
    chunks = one.add(np.ones(CHUNK_SAMPLES + 100, "<i2").tobytes()) + one.end()
    assert [len(chunk) for chunk in chunks] == [CHUNK_SAMPLES] * 2
    assert (chunks[1].sum(), one.samples) == (100, CHUNK_SAMPLES + 100)


def test_chunks_are_as_long_as_the_avatars() -> None:
    one = SpeechItem("a", "r", 0, 0, Decoder(), begun=0.0, chunk=ChunkSize(3))
    chunks = one.add(np.ones(10_000, "<i2").tobytes()) + one.end()
    assert [len(chunk) for chunk in chunks] == [9_600, 9_600]
    for at in (19_200, 28_800):
        one.note_returned(at)
    assert (one.clock_at(9_700), one.frame(1), one.speech(1).sum()) == (28_900, 12, 400)


def test_samples_are_found_on_the_avatars_clock_across_gaps() -> None:
    one = voice()
    one.add(np.ones(3 * CHUNK_SAMPLES, "<i2").tobytes())
    for at in (12_800, 32_000, 38_400, 32_000):
        one.note_returned(at)
    assert [one.clock_at(s) for s in (0, 6_399, 6_400, 12_800, 19_200, 19_201)] == [
        12_800,
        19_199,
        32_000,
        38_400,
        44_800,
        None,
    ]
    one.void(32_500)
    assert one.clock == [12_800, 32_000]


def test_the_playing_item_is_estimated_from_when_its_sound_arrived() -> None:
    items = SpeechItems()
    first, second = voice("a", 10.0), voice("b", 10.1)
    items.begin(first)
    first.add(np.ones(24_000, "<i2").tobytes())
    first.end()
    items.begin(second)
    second.add(np.ones(24_000, "<i2").tobytes())
    assert second.begun == 11.0  # it follows the first
    assert items.playing_at(9.0) is None
    assert items.playing_at(10.5) is first
    assert items.playing_at(11.5) is second
    assert items.playing_at(12.2) is second  # more sound may come
    assert items.playing_at(13.0) is None  # it has stalled
    assert (first.heard(10.5), first.heard(99.0)) == (12_000, 24_000)


def test_speech_is_silent_from_where_it_was_cut() -> None:
    one = voice()
    one.add(np.ones(2 * CHUNK_SAMPLES, "<i2").tobytes())
    one.cut = CHUNK_SAMPLES + 100
    assert (one.speech(0).sum(), one.speech(1).sum(), one.speech(7).sum()) == (CHUNK_SAMPLES, 100, 0)
