"""YUV 4:2:0 planes for video encoders: luma of each pixel, chroma of two by two (BT.601, limited range)."""

import numpy as np

from echoavatar.nn.kernels import kernel

N, U = np.int32, np.uint64
HALF, BLACK, GREY = N(1 << 15), N(16 << 16), N(128 << 16)


@kernel()
def to_planes(image, box, luma, blue, red):  # type: ignore[no-untyped-def]
    """Write `box` (even sides) of `image` (h, w, 3 or 4) sRGB into `luma` (h, w), Cb `blue` and Cr `red` (h/2, w/2)."""
    # Unsigned: numba tests whether signed indices are negative, and then does not vectorise the loops.
    left, top, right, bottom = U(box[0]), U(box[1]), U(box[2]), U(box[3])
    for row in range(top, bottom):
        line, target = image[row], luma[row]
        for column in range(left, right):
            r, g, b = N(line[column, 0]), N(line[column, 1]), N(line[column, 2])
            target[column] = (N(16829) * r + N(33039) * g + N(6416) * b + BLACK + HALF) >> N(16)
    for row in range(top // U(2), bottom // U(2)):
        upper, lower, cb, cr = image[U(2) * row], image[U(2) * row + U(1)], blue[row], red[row]
        for column in range(left // U(2), right // U(2)):
            x, y = U(2) * column, U(2) * column + U(1)
            r = N(upper[x, 0]) + N(upper[y, 0]) + N(lower[x, 0]) + N(lower[y, 0])
            g = N(upper[x, 1]) + N(upper[y, 1]) + N(lower[x, 1]) + N(lower[y, 1])
            b = N(upper[x, 2]) + N(upper[y, 2]) + N(lower[x, 2]) + N(lower[y, 2])
            cb[column] = (((N(28784) * b - N(9714) * r - N(19070) * g) >> N(2)) + GREY + HALF) >> N(16)
            cr[column] = (((N(28784) * r - N(24103) * g - N(4681) * b) >> N(2)) + GREY + HALF) >> N(16)
