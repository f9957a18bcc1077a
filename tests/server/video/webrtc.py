"""A WebRTC viewer that times what it sees and hears by its decoders.

The viewer knows the time of a picture and of a sound as a browser does: from the RTP clock of each track, and from the
sender's reports, which tie it to one wall clock.
"""

import asyncio
import urllib.error
import urllib.request
from collections.abc import Callable
from typing import Any

import numpy as np
from aiortc import RTCConfiguration, RTCPeerConnection, RTCSessionDescription
from aiortc.rtp import RtcpSrPacket
from tests.server.video.flashes import middles, runs


class Watcher:
    """A peer that only receives."""

    def __init__(self) -> None:
        self.peer = RTCPeerConnection(RTCConfiguration(iceServers=[]))
        self.pictures: list[tuple[int, float]] = []  # RTP time, brightness
        self.arrivals: list[float] = []
        self.sounds: list[tuple[int, np.ndarray]] = []  # RTP time, samples at 48 kHz
        self.reports: dict[str, list[tuple[float, int]]] = {"audio": [], "video": []}  # seconds, RTP time
        self.last: np.ndarray | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self.peer.on("track", self._follow)

    async def offer(self, *kinds: str) -> str:
        for kind in kinds or ("video", "audio"):
            self.peer.addTransceiver(kind, direction="recvonly")
        await self.peer.setLocalDescription(await self.peer.createOffer())
        return str(self.peer.localDescription.sdp)

    async def accept(self, answer: str) -> None:
        await self.peer.setRemoteDescription(RTCSessionDescription(answer, "answer"))

    async def until(self, what: Callable[[], bool], seconds: float = 20.0) -> None:
        async with asyncio.timeout(seconds):
            while not what():  # noqa: ASYNC110
                await asyncio.sleep(0.02)

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await self.peer.close()

    def _follow(self, track: Any) -> None:
        receiver = next(found for found in self.peer.getReceivers() if found.track is track)
        handle = receiver._handle_rtcp_packet

        async def noting(packet: Any) -> None:
            if isinstance(packet, RtcpSrPacket) and packet.sender_info.packet_count:
                told = packet.sender_info
                self.reports[track.kind].append((told.ntp_timestamp / 2**32, told.rtp_timestamp))
            await handle(packet)

        receiver._handle_rtcp_packet = noting
        self._tasks.append(asyncio.ensure_future(self._read(track)))

    def _origin(self, track: Any) -> int:
        """RTP time of the track's first frame; aiortc counts from there."""
        receiver = next(found for found in self.peer.getReceivers() if found.track is track)
        return int(receiver._RTCRtpReceiver__timestamp_mapper._origin)

    async def _read(self, track: Any) -> None:
        while True:
            frame = await track.recv()
            if track.kind == "audio":
                self.sounds.append((frame.pts + self._origin(track), frame.to_ndarray().reshape(-1, 2)[:, 0]))
            else:
                self.last = frame.to_ndarray(format="rgb24")
                self.pictures.append((frame.pts + self._origin(track), float(self.last.mean())))
                self.arrivals.append(asyncio.get_running_loop().time())

    # ---- what was measured

    def seconds(self, kind: str, times: Any) -> np.ndarray:
        """Seconds of the sender's wall clock at RTP times, by all of its reports."""
        rate = {"audio": 48_000, "video": 90_000}[kind]
        reports = np.array(self.reports[kind], np.float64)
        offset = np.median(reports[:, 0] - reports[:, 1] / rate)
        return np.asarray(times, np.float64) / rate + offset

    def rate(self) -> float:
        """Pictures a second."""
        times = self.seconds("video", [time for time, _ in self.pictures])
        return float((len(times) - 1) / (times[-1] - times[0]))

    def flashes(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles of the flashes, in seconds, and how far off each may be; a flash lasts from picture to picture."""
        times = self.seconds("video", [time for time, _ in self.pictures])
        light = np.array([light for _, light in self.pictures])
        return runs(times, (light - light.min()) / (light.max() - light.min()))

    def beeps(self) -> np.ndarray:
        """Middles of the beeps, in seconds."""
        first, samples = self.sounds[0][0], np.concatenate([samples for _, samples in self.sounds])
        rms = np.sqrt((samples[: len(samples) // 48 * 48].reshape(-1, 48).astype(float) ** 2).mean(1))
        times = self.seconds("audio", first + 48 * np.arange(len(rms)) + 24)
        return middles(times, np.clip(rms / 8_000, 0, 1))

    def offsets(self) -> tuple[np.ndarray, np.ndarray]:
        """Seconds that each flash comes after its beep, and how far off each may be."""
        (flashes, doubts), beeps = self.flashes(), self.beeps()
        offsets = np.array([flash - beeps[np.abs(beeps - flash).argmin()] for flash in flashes])
        near = np.abs(offsets) < 0.3
        return offsets[near], doubts[near]


def http(
    method: str, url: str, body: bytes = b"", kind: str = "application/sdp", **headers: str
) -> tuple[int, Any, str]:
    """Status, headers and text of an answer."""
    given = {"content-type": kind} | {name.replace("_", "-"): value for name, value in headers.items()}
    request = urllib.request.Request(url, body or None, given, method=method)
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, answer.headers, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.headers, error.read().decode()
