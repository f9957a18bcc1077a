import pytest
from tests.models.generator.tiny import generator

from echoavatar.models.generator import open_stream
from echoavatar.models.generator.depth_stream import DepthStream
from echoavatar.models.generator.stream import InterleavedStream, PrefixStream


@pytest.mark.parametrize(
    ("sequence", "kind"), [("interleaved", InterleavedStream), ("prefix", PrefixStream), ("depth", DepthStream)]
)
def test_every_order_has_its_stream(sequence, kind):
    assert type(open_stream(generator(sequence=sequence))) is kind
