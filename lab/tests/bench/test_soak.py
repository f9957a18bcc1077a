from collections import Counter
from pathlib import Path

import msgspec
import pytest

from echoavatar.wire.codec import decode_server
from echoavatar.wire.messages import Error, Flush, Motion, ServerMessage, Sound
from echoavatar_lab.bench.soak import Watcher, bench_soak, draw


def motion(at: int, epoch: int = 0) -> Motion:
    return Motion(at=at, epoch=epoch, frames=8, rotations=b"", root=b"", face=b"", state="idle")


def sound(at: int, epoch: int = 0) -> Sound:
    return Sound(at=at, epoch=epoch, seg=0, pcm=bytes(12_800))


def seen(*messages: ServerMessage) -> Counter[str]:
    watcher = Watcher()
    for message in messages:
        watcher.see(message)
    return +watcher.counts


def test_a_whole_session_is_one_without_holes_and_repeats() -> None:
    assert seen(sound(0), motion(0), sound(6_400), motion(6_400)) == {"frames": 16}
    flush = Flush(at=3_200, epoch=1, seg=0, heard=0)
    assert seen(sound(0), motion(0), flush, sound(3_200, 1), motion(3_200, 1)) == {"frames": 16}


def test_what_is_missing_doubled_or_stale_is_counted() -> None:
    assert seen(sound(0), sound(12_800))["missing"] == 1
    assert seen(motion(0), motion(12_800))["dropped"] == 8
    assert seen(sound(0), sound(0), motion(0), motion(0))["doubled"] == 2
    assert seen(sound(0), Flush(at=0, epoch=1, seg=0, heard=0), sound(0))["stale"] == 1
    assert seen(Error(code="internal", message="", fatal=True, retry_after=1.0))["lost"] == 1
    assert seen(Error(code="internal", message="", fatal=False, retry_after=0.0))["lost"] == 0


def test_what_a_resumed_session_sends_again_is_not_doubled() -> None:
    """The connection broke between the motion of a chunk and its sound, so both are sent again."""
    example = decode_server(Path("tests/fixtures/wire/ready.bin").read_bytes())
    resumed = msgspec.structs.replace(example, resumed=True, at=6_400, epoch=0)
    assert seen(sound(0), motion(0), motion(6_400), resumed, motion(6_400), sound(6_400))["doubled"] == 0
    assert seen(sound(0), motion(0), resumed, motion(6_400), motion(6_400))["doubled"] == 1


@pytest.mark.slow
def test_a_short_soak_of_a_tiny_bundle(tiny_bundle: Path) -> None:
    report = bench_soak(str(tiny_bundle), sessions=2, minutes=0.1, progress=lambda _: None)
    assert report["frames"] > 2 * 5 * 30
    assert report["turns"] > 0
    assert not any(report[name] for name in ("stale", "doubled", "missing", "lost", "restarts"))
    assert msgspec.json.encode(report)


def test_the_memory_of_a_soak_is_drawn(tmp_path: Path) -> None:
    report = {"memory_mb": [(0, 700.0), (60, 800.0), (120, 801.0)], "slope_mb_an_hour": 60.0, "turns": 7}
    draw(report, tmp_path / "soak.png")
    assert (tmp_path / "soak.png").read_bytes()[:4] == b"\x89PNG"
