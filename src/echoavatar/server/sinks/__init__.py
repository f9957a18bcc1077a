"""Live motion to other programs: VMC (OSC), Live Link Face and JSON over UDP, each at its own rate.

May import `wire`, `models`, `motion` and below. Every sink has a thread of its own. The code that feeds a sink never
waits for it, and a receiver that is slow or gone affects nothing here.
"""

from .encoders import Frame
from .player import SinkGroup, SinkPlayer
from .sink import UdpSink, check_address, make_sink, parse_address

__all__ = ["Frame", "SinkGroup", "SinkPlayer", "UdpSink", "check_address", "make_sink", "parse_address"]
