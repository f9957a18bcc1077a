"""Motion and sound that match, and halves that are missing."""

import msgspec
import pytest

from echoavatar.agents.integrations.output import make_chunk
from echoavatar.wire import Motion, Sound

MOTION = Motion(at=6_400, epoch=1, frames=8, rotations=b"r", root=b"t", face=b"", state="speaking")
SOUND = Sound(at=6_400, epoch=1, seg=2, pcm=b"\x01\x00" * 6_400)
SILENCE = msgspec.structs.replace(SOUND, pcm=bytes(12_800))


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
