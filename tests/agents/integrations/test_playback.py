"""Playback estimates with times given by hand; a second is 24,000 samples."""

import msgspec
import pytest

from echoavatar.agents.integrations.playback import GRACE_S, Playback, make_chunk
from echoavatar.wire.messages import Motion, Sound

MOTION = Motion(at=6_400, epoch=1, frames=8, rotations=b"r", root=b"t", face=b"", state="speaking")
SOUND = Sound(at=6_400, epoch=1, seg=2, pcm=b"\x01\x00" * 6_400)
SILENCE = msgspec.structs.replace(SOUND, pcm=bytes(12_800))


def test_without_reports_the_wall_clock_counts_up_to_the_end_of_the_sound() -> None:
    playback = Playback(0, 10.0)
    playback.pushed(0, 24_000, audible=True)
    assert playback.position(10.5) == 12_000
    assert playback.is_sounding
    assert playback.position(12.0) == 24_000
    assert not playback.is_sounding
    playback.pushed(24_000, 24_000, audible=False)
    assert playback.position(12.5) == 36_000


def test_reports_are_believed_and_the_clock_runs_on_between_them() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 48_000, audible=True)
    playback.wrote(0.04, 0.3)  # playback began late
    assert playback.position(0.3) == 960
    assert playback.position(0.34) == pytest.approx(1_920, abs=1)


def test_a_transport_that_is_stuck_stops_the_clock() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 48_000, audible=True)
    playback.wrote(0.5, 0.5)
    assert playback.position(9.0) == 12_000 + GRACE_S * 24_000


def test_silence_between_sounds_takes_time_without_reports() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 24_000, audible=True)
    playback.pushed(24_000, 24_000, audible=False)
    playback.pushed(48_000, 24_000, audible=True)
    playback.wrote(0.98, 1.0)  # the last block is kept back until more sound comes
    assert playback.position(1.5) == pytest.approx(0.98 * 24_000 + 12_000, abs=1)
    assert playback.position(9.0) == 48_000 + GRACE_S * 24_000
    playback.wrote(0.02 + 0.1, 9.0)
    assert playback.position(9.0) == pytest.approx(48_000 + 2_400, abs=1)


def test_an_exact_report_overrides_the_estimate() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 24_000, audible=True)
    playback.plays(6_000, 1.0)
    assert playback.position(1.0) == 6_000
    playback.plays(99_000, 1.0)
    assert playback.position(1.0) == 24_000


def test_after_a_cut_it_stands_there() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 48_000, audible=True)
    playback.wrote(1.0, 1.0)
    playback.jump(24_000, 1.0)
    playback.wrote(0.04, 1.1)  # a block that was being written during the jump
    assert playback.position(5.0) == 24_000
    assert not playback.is_sounding


def test_motion_and_sound_of_one_clock_are_a_chunk() -> None:
    chunk = make_chunk(MOTION, SOUND, released_to=0, cut_seg=0)
    assert (chunk.motion, chunk.pcm, chunk.at, chunk.seg, chunk.is_revision) == (MOTION, SOUND.pcm, 6_400, 2, False)


@pytest.mark.parametrize("motion", [None, msgspec.structs.replace(MOTION, at=0)])
def test_lost_motion_does_not_cost_the_sound(motion: Motion | None) -> None:
    chunk = make_chunk(motion, SOUND, released_to=0, cut_seg=0)
    assert (chunk.motion.at, chunk.motion.rotations, chunk.pcm) == (6_400, b"", SOUND.pcm)
    longer = msgspec.structs.replace(SOUND, pcm=bytes(2 * 9_600))
    assert [make_chunk(None, sound, released_to=0, cut_seg=0).motion.frames for sound in (SOUND, longer)] == [8, 12]


def test_a_pause_within_speech_is_sound_and_silence_around_speech_is_not() -> None:
    assert make_chunk(MOTION, SILENCE, released_to=0, cut_seg=0).pcm == SILENCE.pcm
    idle = msgspec.structs.replace(SILENCE, seg=0)
    assert make_chunk(MOTION, idle, released_to=0, cut_seg=0).pcm == b""
    assert make_chunk(MOTION, SILENCE, released_to=0, cut_seg=2).pcm == b"", "the rest of a chunk that was cut"


def test_music_after_a_cut_is_no_speech() -> None:
    chunk = make_chunk(MOTION, SOUND, released_to=0, cut_seg=2)
    assert (chunk.seg, chunk.pcm) == (0, SOUND.pcm)


def test_remade_motion_brings_no_sound() -> None:
    chunk = make_chunk(MOTION, SOUND, released_to=12_800, cut_seg=0)
    assert (chunk.pcm, chunk.is_revision) == (b"", True)
