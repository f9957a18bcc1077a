"""Measure live video: what a viewer costs the server, and the pictures that arrive (docs/video.md).

    python scripts/measure_video.py                 # starts a server of its own; about a minute and a half
    python scripts/measure_video.py --view bust
    python scripts/measure_video.py --costs         # only the processor time of drawing and encoding a picture
    python scripts/measure_video.py --renderers     # processor and graphics card: time, and how pictures differ

Needs the extra `video` (`--renderers` needs `gpu` instead), and Linux, which tells processor time by process. The
viewer decodes in this process, on the same processors. How far pictures and sound are apart is measured by
`pytest -m slow -s tests/server/test_whep.py`.
"""

import argparse
import asyncio
import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any, get_args

import av

from echoavatar import outgoing
from echoavatar.agents.client import Avatar, connect
from echoavatar.models.audio import read_audio

SPEECH = Path(__file__).parents[1] / "src/echoavatar/assets/speech.ogg"
TICKS = os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Measure, and print a row of the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20, help="of each part (default: %(default)s)")
    parser.add_argument("--view", default="front", help="front, bust, face, ... (default: %(default)s)")
    parser.add_argument("--size", default="512", help="pixels (default: %(default)s)")
    parser.add_argument("--costs", action="store_true", help="measure drawing and encoding alone, without a server")
    parser.add_argument("--renderers", action="store_true", help="compare the renderers of `cpu` and `gpu`")
    args = parser.parse_args()
    if args.renderers:
        compare(int(args.size))
        return
    if args.costs:
        costs(int(args.size))
        return
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = ["serve", "--video", "1", "--video-size", args.size, "--port", str(port)]
    server = subprocess.Popen([sys.executable, "-m", "echoavatar", *words], stdout=subprocess.DEVNULL)
    try:
        asyncio.run(measure(f"http://127.0.0.1:{port}", server.pid, args))
    finally:
        server.terminate()
        server.wait(60)


def costs(size: int, count: int = 60) -> None:
    """Processor time of a picture of the bundled speech: drawing, and encoding as aiortc does."""
    from aiortc.codecs.h264 import H264Encoder
    from aiortc.codecs.vpx import Vp8Encoder

    from echoavatar import animate
    from echoavatar.files.avatar.avatar_renderer import Shot
    from echoavatar.motion.kinematics import HUMANOID
    from echoavatar.server.video import VideoSource
    from echoavatar.wire.blobs import Pose, pack_pose
    from echoavatar.wire.messages import Rig

    made, config = animate(SPEECH), HUMANOID.config
    print("| view | drawing, ms | VP8, ms | H.264, ms |\n|---|---|---|---|")
    for view in ("front", "bust"):
        source = VideoSource(Rig(names=config.names, parents=config.parents, rest=config.offsets),
                             Shot((size, size), view))  # fmt: skip
        source.take(pack_pose(Pose(made.motion.rotations, made.motion.root, made.face), at=0))
        source.picture(0)
        began = time.process_time()
        pictures = [source.picture(24_000 + 960 * index) for index in range(count)]
        times = [time.process_time() - began]
        for encoder in (Vp8Encoder(), H264Encoder()):
            began = time.process_time()
            for index, pixels in enumerate(pictures):
                frame = av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(format="yuv420p")
                frame.pts, frame.time_base = 3_600 * index, Fraction(1, 90_000)
                encoder.encode(frame)
            times.append(time.process_time() - began)
        print(f"| {view} | " + " | ".join(f"{1e3 * spent / count:.1f}" for spent in times) + " |")


def compare(size: int, count: int = 10) -> None:
    """Both renderers draw poses of the bundled speech: milliseconds a picture, and differences of 255."""
    import numpy as np

    from echoavatar import animate
    from echoavatar.files.avatar import load_character
    from echoavatar.files.avatar.avatar_renderer import AvatarRenderer, RendererName, Shot
    from echoavatar.files.avatar.backdrop import Backdrop
    from echoavatar.files.avatar.framing import View
    from echoavatar.files.avatar.gpu_render import GpuRenderer

    made, character = animate(SPEECH), load_character()
    views: tuple[View, ...] = ("front", "bust", "face")
    print(f"{GpuRenderer(8, 8).card}; load {os.getloadavg()[0]:.1f}\n")
    print(
        "| view | background | cpu, ms | gpu, ms | mean difference | on the body | share that differs by more than 8 |"
    )
    print("|---|---|---|---|---|---|---|")
    frames = np.linspace(0, made.motion.frames - 1, count).astype(int)
    pose = made.motion.pose()
    rotations, positions = pose.rotations[frames], pose.positions[frames]
    for view in views:
        for background in ("studio", "dusk", "plain"):
            shots, times = [], []
            for renderer in get_args(RendererName):
                drawer = AvatarRenderer(character, Shot((size, size), view, background, renderer=renderer))
                drawer.draw(rotations[0], positions[0])
                began = time.perf_counter()
                shots.append(np.stack([drawer.draw(*pose) for pose in zip(rotations, positions, strict=True)]))
                times.append(1e3 * (time.perf_counter() - began) / count)
            off = np.abs(shots[0].astype(int) - shots[1])
            body = np.abs(shots[0].astype(int) - Backdrop.of(background).picture(size, size)).max(-1) > 8
            print(f"| {view} | {background} | {times[0]:.1f} | {times[1]:.1f} | {off.mean():.2f} "
                  f"| {off[body].mean():.2f} | {100 * (off.max(-1) > 8).mean():.1f} % |")  # fmt: skip


async def measure(url: str, process: int, args: argparse.Namespace) -> None:
    """One session that speaks, alone and then with a viewer."""
    for _ in range(240):
        try:
            await asyncio.to_thread(outgoing.fetch, f"{url}/health")
            break
        except outgoing.OutgoingError:
            await asyncio.sleep(0.5)
    samples = read_audio(SPEECH)
    async with connect(url) as avatar:
        reading = asyncio.ensure_future(drain(avatar))
        for _ in range(5):
            await avatar.speak(samples)
        await asyncio.sleep(3)
        alone, _ = await share(process, args.seconds, lambda: 0)
        viewer, pictures = await watch(f"{url}/v1/sessions/{avatar.ready.session}/whep?view={args.view}")
        await asyncio.sleep(4)
        both, rate_hz = await share(process, args.seconds, lambda: len(pictures))
        await viewer.close()
        reading.cancel()
    print("| view | pixels | load | motion alone, processors | with a viewer | pictures a second | ms a picture |")
    print(f"| {args.view} | {args.size} | {os.getloadavg()[0]:.1f} | {alone:.2f} | {both:.2f} | {rate_hz:.1f} "
          f"| {1e3 * (both - alone) / max(rate_hz, 0.1):.0f} |")  # fmt: skip


async def drain(avatar: Avatar) -> None:
    """Read all messages, as a player does."""
    async for _ in avatar:
        pass


async def watch(url: str) -> tuple[Any, list[float]]:
    """A WebRTC viewer, and the times of its decoded pictures."""
    from aiortc import RTCConfiguration, RTCPeerConnection, RTCSessionDescription
    from aiortc.mediastreams import MediaStreamError

    peer, times, tasks = RTCPeerConnection(RTCConfiguration(iceServers=[])), list[float](), set[Any]()

    async def read(track: Any) -> None:
        with suppress(MediaStreamError):
            while True:
                await track.recv()
                if track.kind == "video":
                    times.append(time.monotonic())

    peer.on("track", lambda track: tasks.add(asyncio.ensure_future(read(track))))
    for kind in ("video", "audio"):
        peer.addTransceiver(kind, direction="recvonly")
    await peer.setLocalDescription(await peer.createOffer())
    offer, headers = peer.localDescription.sdp.encode(), {"content-type": "application/sdp"}
    answer = await asyncio.to_thread(lambda: outgoing.fetch(url, offer, headers=headers))
    await peer.setRemoteDescription(RTCSessionDescription(answer.decode(), "answer"))
    return peer, times


async def share(process: int, seconds: float, count: Any) -> tuple[float, float]:
    """Processors that the server keeps busy, and what is counted per second."""
    began, used, counted = time.monotonic(), busy(process), count()
    await asyncio.sleep(seconds)
    passed = time.monotonic() - began
    return (busy(process) - used) / passed, (count() - counted) / passed


def busy(process: int) -> float:
    """Seconds of processor time of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


if __name__ == "__main__":
    main()
