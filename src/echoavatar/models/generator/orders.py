"""Which stream serves which order of the sequence."""

from .depth_stream import DepthStream
from .linear import Precision
from .model import Generator
from .stream import InterleavedStream, PrefixStream


def open_stream(
    generator: Generator, precision: Precision = "float32", *, is_guided: bool = True
) -> InterleavedStream | PrefixStream | DepthStream:
    """The stream of this generator's sequence order; `is_guided`: with the config's guidance, if any."""
    match generator.config.sequence:
        case "interleaved":
            return InterleavedStream(generator, precision)
        case "prefix":
            return PrefixStream(generator, precision)
        case "depth":
            return DepthStream(generator, precision, is_guided=is_guided)
