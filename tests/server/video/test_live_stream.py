"""Wall time, the playhead, and a machine that is too slow."""

import asyncio
import time

import numpy as np
import pytest

from echoavatar.server.video import live_stream
from echoavatar.server.video.live_stream import BLOCK_SAMPLES, EDGE, LiveStream, doubled

BLACK = np.zeros((2, 2, 3), np.uint8)


class Session:
    """Sample n has the value n / 24 (milliseconds); a picture takes `draw_s`."""

    def __init__(self, *, draw_s: float = 0.0, end: int = 10**9) -> None:
        self.draw_s, self.end = draw_s, end
        self.began, self.start = time.monotonic(), 0
        self.pictured: list[float] = []

    def playhead(self) -> int:
        return min(self.end, self.start + round((time.monotonic() - self.began) * 24_000))

    def sound(self, at: int, count: int) -> np.ndarray:
        return (np.arange(at, at + count) // 24).astype(np.int16)

    def picture(self, at: float) -> np.ndarray:
        time.sleep(self.draw_s)
        self.pictured.append(at)
        return BLACK


def inner(samples: np.ndarray) -> np.ndarray:
    return samples[EDGE:-EDGE]


async def test_sound_goes_on_without_a_gap_at_the_playhead() -> None:
    session = Session()
    session.start = 48_000
    stream = LiveStream(session, session.playhead)
    blocks = [await stream.sound() for _ in range(15)]
    heard = np.concatenate([inner(block.samples) for block in blocks])
    assert (np.diff(heard) >= 0).all()
    assert np.diff(heard).max() == 1
    assert abs(int(heard[-1]) - session.playhead() / 24) < 150
    assert np.allclose(np.diff([block.seconds for block in blocks]), BLOCK_SAMPLES / 24_000)
    await stream.close()


@pytest.mark.parametrize(("late_s", "skips"), [(0.1, True), (0.5, False)])
async def test_after_a_hiccup_late_sound_is_handed_out_or_skipped(late_s: float, skips: bool) -> None:
    session = Session()
    stream = LiveStream(session, session.playhead, late_s=late_s)
    before = [await stream.sound() for _ in range(5)][-1]
    time.sleep(0.3)  # noqa: ASYNC251
    after = await stream.sound()
    gap_s = after.seconds - before.seconds
    assert gap_s > 0.25 if skips else gap_s == pytest.approx(0.02)
    await stream.close()


async def test_a_picture_shows_the_sound_of_its_moment() -> None:
    session = Session(draw_s=0.005)
    stream = LiveStream(session, session.playhead)

    async def pictures() -> list[float]:
        return [(await stream.picture()).seconds for _ in range(8)]

    async def sounds() -> list[tuple[float, int]]:
        blocks = [await stream.sound() for _ in range(15)]
        return [(block.seconds, int(inner(block.samples)[0])) for block in blocks]

    seen, heard = await asyncio.gather(pictures(), sounds())
    lag_s = heard[-1][0] - heard[-1][1] / 1_000
    for seconds, at in zip(seen, session.pictured, strict=False):
        assert abs(seconds - at / 24_000 - lag_s) < 0.002
    await stream.close()


async def test_a_slow_machine_shows_fewer_pictures_and_none_twice() -> None:
    session = Session(draw_s=0.1)
    stream = LiveStream(session, session.playhead)
    shown = [(await stream.picture()).seconds for _ in range(8)]
    gaps = np.diff(shown)
    assert (gaps > 0.03).all()
    assert gaps[-3:].sum() >= 3 * session.draw_s - 0.04  # times are those of whole pictures, 25 a second
    assert stream.skipped > 5
    await stream.close()


async def test_one_picture_that_is_held_up_makes_none_be_left_out() -> None:
    session = Session(draw_s=0.005)
    stream = LiveStream(session, session.playhead)
    for _ in range(10):
        await stream.picture()
    skipped, session.draw_s = stream.skipped, 0.06
    await stream.picture()
    session.draw_s = 0.005
    for _ in range(5):
        await stream.picture()
    assert stream.skipped == skipped
    await stream.close()


async def test_where_nothing_arrived_there_is_silence_and_nothing_is_lost() -> None:
    session = Session(end=4_800)
    session.start = 2_400
    stream = LiveStream(session, session.playhead)
    first = [inner((await stream.sound()).samples) for _ in range(12)]
    assert not first[-1].any()
    session.end, session.start, session.began = 10**9, 4_800, time.monotonic()
    more = [inner((await stream.sound()).samples) for _ in range(8)]
    heard = np.concatenate([*first, *more])
    heard = heard[heard > 0]
    assert np.diff(heard).max() == 1
    await stream.close()


async def test_it_jumps_to_a_playhead_that_is_far_off() -> None:
    session = Session()
    stream = LiveStream(session, session.playhead)
    await stream.sound()
    session.start = 240_000
    blocks = [await stream.sound() for _ in range(4)]
    assert int(inner(blocks[-1].samples)[0]) > 9_900
    await stream.close()


class Watch:
    """A clock that stands until it is set, in the place of the module `time`."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.mark.parametrize(("off_s", "jumps"), [(0.2, False), (0.3, True)])
async def test_it_jumps_to_a_playhead_that_is_off_by_a_quarter_of_a_second(
    monkeypatch: pytest.MonkeyPatch, off_s: float, jumps: bool
) -> None:
    watch, session, ahead = Watch(), Session(), 0.0
    monkeypatch.setattr(live_stream, "time", watch)
    stream = LiveStream(session, lambda: round((watch.now - 100.0 + ahead) * 24_000))
    assert stream.place == 0
    ahead = off_s
    for _ in range(2):
        watch.now += 0.1
        place = stream.place
    assert (place > 0.3 * 24_000) == jumps
    await stream.close()


async def test_sound_that_is_half_a_second_late_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    """After 0.4 s in which nobody asked the next block follows; after 0.6 s more the newest one."""
    watch, session = Watch(), Session()
    monkeypatch.setattr(live_stream, "time", watch)
    stream, begins = LiveStream(session, lambda: 0), []
    for pause in (0.0, 0.4, 0.6):
        watch.now += pause
        begins.append((await stream.sound()).seconds)
    assert begins[1] - begins[0] == pytest.approx(0.02)
    assert begins[2] - begins[1] > 0.9
    await stream.close()


async def test_a_picture_asks_for_motion_of_the_next_tenth_of_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long it takes to draw, as later motion may not be there yet; and not for less, or it would be late."""
    watch, session = Watch(), Session()
    monkeypatch.setattr(live_stream, "time", watch)
    stream = LiveStream(session, lambda: 0)
    stream._draw_s = 0.3
    await stream.picture()
    assert 0.1 < session.pictured[0] / 24_000 < 0.2
    await stream.close()


async def test_a_stream_may_be_closed_while_it_draws() -> None:
    session = Session(draw_s=0.3)
    stream = LiveStream(session, session.playhead)
    waiting = asyncio.ensure_future(stream.picture())
    await asyncio.sleep(0.2)
    waiting.cancel()
    began = time.monotonic()
    await stream.close()
    assert time.monotonic() - began < 0.25


@pytest.mark.parametrize("hertz", [100, 1_000, 5_000, 9_000])
def test_a_tone_at_twice_the_rate_is_the_same_tone_at_the_same_time(hertz: float) -> None:
    moments = (np.arange(BLOCK_SAMPLES + 2 * EDGE) - EDGE) / 24_000
    samples = np.rint(10_000 * np.sin(2 * np.pi * hertz * moments)).astype(np.int16)
    wanted = 10_000 * np.sin(2 * np.pi * hertz * np.arange(2 * BLOCK_SAMPLES) / 48_000)
    assert np.abs(doubled(samples) - wanted).max() < 150


def test_the_loudest_sound_does_not_wrap_around() -> None:
    samples = np.where(np.arange(BLOCK_SAMPLES + 2 * EDGE) // 7 % 2, 32_767, -32_768).astype(np.int16)
    assert (np.sign(doubled(samples)[::2]) == np.sign(samples[EDGE:-EDGE])).all()


async def test_picture_and_sound_stay_together_when_the_wall_clock_is_set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session()
    stream = LiveStream(session, session.playhead)
    before = stream.wall(1.0)
    assert before == pytest.approx(time.time() + 1.0, abs=0.5)
    monkeypatch.setattr(time, "time", lambda: before - 3_600)
    assert stream.wall(1.5) - before == pytest.approx(0.5)
    await stream.close()
