"""Which stream serves which order of the sequence."""

from .depth_stream import DepthStream
from .linear import Precision
from .model import Generator
from .stream import InterleavedStream, PrefixStream


def open_stream(
    generator: Generator, precision: Precision = "float32"
) -> InterleavedStream | PrefixStream | DepthStream:
    """The stream of this generator's sequence order."""
    match generator.config.sequence:
        case "interleaved":
            return InterleavedStream(generator, precision)
        case "prefix":
            return PrefixStream(generator, precision)
        case "depth":
            return DepthStream(generator, precision)
