"""Halves that fit, halves that are missing."""

import msgspec
import pytest

from echoavatar.integrations.hop import make_hop
from echoavatar.wire import Motion, Sound

MOTION = Motion(at=6_400, epoch=1, frames=8, rotations=b"r", root=b"t", face=b"", state="speaking")
SOUND = Sound(at=6_400, epoch=1, seg=2, pcm=b"\x01\x00" * 6_400)
SILENCE = msgspec.structs.replace(SOUND, pcm=bytes(12_800))


def test_motion_and_sound_of_one_clock_are_a_hop() -> None:
    hop = make_hop(MOTION, SOUND, left=0, cut_seg=0)
    assert (hop.motion, hop.pcm, hop.at, hop.seg, hop.is_again) == (MOTION, SOUND.pcm, 6_400, 2, False)


@pytest.mark.parametrize("motion", [None, msgspec.structs.replace(MOTION, at=0)])
def test_lost_motion_does_not_cost_the_sound(motion: Motion | None) -> None:
    hop = make_hop(motion, SOUND, left=0, cut_seg=0)
    assert (hop.motion.at, hop.motion.rotations, hop.pcm) == (6_400, b"", SOUND.pcm)
    longer = msgspec.structs.replace(SOUND, pcm=bytes(2 * 9_600))
    assert [make_hop(None, sound, left=0, cut_seg=0).motion.frames for sound in (SOUND, longer)] == [8, 12]


def test_a_pause_in_speech_is_sound_and_silence_around_it_is_none() -> None:
    assert make_hop(MOTION, SILENCE, left=0, cut_seg=0).pcm == SILENCE.pcm
    idle = msgspec.structs.replace(SILENCE, seg=0)
    assert make_hop(MOTION, idle, left=0, cut_seg=0).pcm == b""
    assert make_hop(MOTION, SILENCE, left=0, cut_seg=2).pcm == b"", "the rest of a chunk that was cut"


def test_music_after_a_cut_is_no_speech() -> None:
    hop = make_hop(MOTION, SOUND, left=0, cut_seg=2)
    assert (hop.seg, hop.pcm) == (0, SOUND.pcm)


def test_motion_made_again_brings_no_sound() -> None:
    hop = make_hop(MOTION, SOUND, left=12_800, cut_seg=0)
    assert (hop.pcm, hop.is_again) == (b"", True)
