"""Sound packed as Opus stays on its sample of the clock."""

import av
import numpy as np
import pytest
from tests.server.rooms import Room, Told

from echoavatar.server.opus import OpusPacker, choose, is_available
from echoavatar.timing import CHUNK_SAMPLES
from echoavatar.wire.messages import PackedSound, Sound

pytestmark = pytest.mark.skipif(not is_available(), reason="PyAV here has no libopus")


def voice(seconds: float) -> np.ndarray:
    """Noise below 3 kHz, whose place is sharp."""
    white = np.random.default_rng(0).normal(0, 1, round(seconds * 24_000))
    return (0.3 * np.convolve(white, np.hanning(16) / 8, "same")).astype(np.float32)


def packed(packer: OpusPacker, sound: np.ndarray, *, at: int = 0, epoch: int = 0) -> list[PackedSound]:
    chunks = sound.reshape(-1, CHUNK_SAMPLES)
    return [packer.pack(chunk, at=at + k * CHUNK_SAMPLES, epoch=epoch, seg=1) for k, chunk in enumerate(chunks)]


def unpacked(messages: list[PackedSound]) -> tuple[int, np.ndarray]:
    """Clock of the first sample, and all samples, as a player decodes them."""
    decoder, out, end = av.CodecContext.create("libopus", "r"), [], messages[0].at
    decoder.sample_rate, decoder.layout = 48_000, "mono"
    for message in messages:
        assert message.at == end  # neither gap nor overlap
        frames = [frame for packet in message.packets for frame in decoder.decode(av.Packet(packet))]
        pcm = np.concatenate([frame.to_ndarray().reshape(-1)[::2] for frame in frames])[message.skip :]
        out.append(pcm / 32_768)
        end += len(pcm)
    return messages[0].at, np.concatenate(out)


def lag(heard: np.ndarray, sound: np.ndarray) -> int:
    """Samples by which `heard` is late."""
    window = sound[4_000:20_000]
    return max(range(-200, 201), key=lambda k: float(np.dot(heard[4_000 + k : 20_000 + k], window)))


def test_what_is_decoded_lies_on_the_sample_from_which_it_came() -> None:
    sound = voice(12 * CHUNK_SAMPLES / 24_000)
    first, heard = unpacked(packed(OpusPacker(), sound))
    assert first == 0
    assert lag(heard, sound) == 0
    assert len(sound) - len(heard) < 0.027 * 24_000


def test_after_an_interrupt_a_new_stream_begins_at_its_clock() -> None:
    sound, packer = voice(12 * CHUNK_SAMPLES / 24_000), OpusPacker()
    packed(packer, sound)
    again = packed(packer, sound, at=10_000, epoch=1)
    assert (again[0].at, again[0].skip) == (10_000, 156)
    assert all(message.skip == 0 for message in again[1:])
    assert lag(unpacked(again)[1], sound) == 0


def test_bytes_of_speech_are_a_tenth_of_pcm() -> None:
    messages = packed(OpusPacker(), voice(24 * CHUNK_SAMPLES / 24_000))
    rate = sum(len(packet) for message in messages for packet in message.packets) / (24 * CHUNK_SAMPLES / 24_000)
    assert 1_400 < rate < 4_800  # of 48,000 bytes a second


def test_who_does_not_ask_gets_pcm() -> None:
    assert choose(()) == choose(("pcm",)) == choose(("vorbis",)) == "pcm"
    assert choose(("vorbis", "opus", "pcm")) == "opus"


def test_old_and_new_clients_of_one_session_each_get_their_form() -> None:
    room, new = Room(), Told()
    new.sound = "opus"
    room.session.join(new, received=None)
    room.go(3.0)
    assert room.box.of(Sound)
    assert not room.box.of(PackedSound)
    assert new.of(PackedSound)
    assert not new.of(Sound)
    assert new.of(PackedSound)[0].at == room.box.of(Sound)[0].at
