import av
import numpy as np

from echoavatar.files.avatar.planes import to_planes


def test_colours_are_those_of_ffmpeg() -> None:
    """Squares of one colour: luma and colour as FFmpeg converts them, within a level."""
    random = np.random.default_rng(0)
    picture = np.repeat(np.repeat(random.integers(0, 256, (8, 8, 3)), 16, 0), 16, 1).astype(np.uint8)
    planes = np.zeros((128, 128), np.uint8), np.zeros((64, 64), np.uint8), np.zeros((64, 64), np.uint8)
    to_planes(picture, (0, 0, 128, 128), *planes)
    frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuv420p")
    for ours, plane in zip(planes, frame.planes, strict=True):
        theirs = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[:, : plane.width]
        middle = 16 * len(ours) // 128
        inside = (slice(middle // 2, None, middle),) * 2  # the middles of the squares
        assert np.abs(ours[inside].astype(int) - theirs[inside]).max() <= 1


def test_nothing_is_written_beside_the_box() -> None:
    picture = np.full((16, 16, 4), 255, np.uint8)
    luma, blue, red = np.zeros((16, 16), np.uint8), np.zeros((8, 8), np.uint8), np.zeros((8, 8), np.uint8)
    to_planes(picture, (4, 2, 10, 8), luma, blue, red)
    assert (luma[2:8, 4:10] == 235).all()
    assert (blue[1:4, 2:5] == 128).all()
    luma[2:8, 4:10] = blue[1:4, 2:5] = red[1:4, 2:5] = 0
    assert not luma.any()
    assert not blue.any()
    assert not red.any()
