"""Live motion to other programs: VMC (OSC), Live Link Face, JSON over UDP, each with a clock and a rate of its own.

May import `face`, `kinematics`, `wire` and below. A sink has a thread; whoever feeds it never waits for it, and what a
receiver does or does not do changes nothing here.
"""

from .address import check_address, make_sink, parse_address
from .player import SinkPlayer
from .sink import Frame, Sink, UdpSink
from .sink_group import SinkGroup

__all__ = [
    "SinkGroup",
    "Frame",
    "Sink",
    "SinkPlayer",
    "UdpSink",
    "check_address",
    "make_sink",
    "parse_address",
]
