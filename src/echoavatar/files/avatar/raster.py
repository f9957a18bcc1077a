"""The visible triangle in each sample of a picture, and the height of the surface towards the light.

One thread draws one picture; two threads draw two. Every loop stays inside the bounding box of its triangles.
Constants are float32, or numba would compute in double precision.
"""

import numpy as np

from echoavatar.nn.kernels import kernel

F = np.float32
U = np.uint64  # unsigned, because numba tests whether signed indices are negative
ZERO, ONE, HALF = F(0.0), F(1.0), F(0.5)
TILE = U(8)  # samples
FAR, TINY = F(1e6), F(1e-9)
REPEATS = F(64.0)  # a picture repeats at most so often to the left or above


@kernel(fastmath=True)
def projected(points, position, axes, focal, width, height, screen):  # type: ignore[no-untyped-def]
    """Fill `screen` (v, 3): x and y in pixels and nearness 1/z, which is 0 behind the camera."""
    for v in range(points.shape[0]):
        x, y, z = points[v, 0] - position[0], points[v, 1] - position[1], points[v, 2] - position[2]
        depth = -(axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z)
        near = ONE / depth if depth > F(0.05) else ZERO
        screen[v, 0] = HALF * width + focal * near * (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z)
        screen[v, 1] = HALF * height - focal * near * (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z)
        screen[v, 2] = near


@kernel(fastmath=True)
def box_of(screen, width, height):  # type: ignore[no-untyped-def]
    """The pixels around the points in front of the camera: left, top, and right, bottom, which are not included."""
    left, top, right, bottom = F(width), F(height), ZERO, ZERO
    for v in range(screen.shape[0]):
        if screen[v, 2] > ZERO:
            left, right = min(left, screen[v, 0]), max(right, screen[v, 0])
            top, bottom = min(top, screen[v, 1]), max(bottom, screen[v, 1])
    return (
        max(0, int(min(left, F(width)))),
        max(0, int(min(top, F(height)))),
        int(min(max(right, ZERO) + ONE, F(width))),
        int(min(max(bottom, ZERO) + ONE, F(height))),
    )


@kernel(fastmath=True)
def bounds(points, towards, box):  # type: ignore[no-untyped-def]
    """Fill `box` (3, 2, 3) with least and greatest coordinates: of the points, of their shadows on y = 0, of both."""
    for k in range(3):
        box[k, 0, :] = F(1e9)
        box[k, 1, :] = F(-1e9)
    for v in range(points.shape[0]):
        height = points[v, 1] / towards[1]
        for i in range(3):
            cast = points[v, i] - height * towards[i]
            box[0, 0, i], box[0, 1, i] = min(box[0, 0, i], points[v, i]), max(box[0, 1, i], points[v, i])
            box[1, 0, i], box[1, 1, i] = min(box[1, 0, i], cast), max(box[1, 1, i], cast)
    for i in range(3):
        box[2, 0, i] = min(box[0, 0, i], box[1, 0, i])
        box[2, 1, i] = max(box[0, 1, i], box[1, 1, i])


@kernel(fastmath=True, inline="always")
def centres(least, greatest, begin, end):  # type: ignore[no-untyped-def]
    """The first sample from `begin` on, and the one after the last, whose centres lie between two coordinates.

    Limits are whole numbers, here and in `span`: they hold even for coordinates that are not finite.
    """
    return max(begin, int(least + HALF)), min(end, int(greatest + HALF))


@kernel(fastmath=True, inline="always")
def barycentric(ax, ay, bx, by, cx, cy, area, column, row):  # type: ignore[no-untyped-def]
    """Weights of a and b at the centre of a sample, and what they gain by the next column, and by the next row."""
    x, y, inverse = F(column) + HALF, F(row) + HALF, ONE / area
    u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) * inverse
    v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) * inverse
    return u, v, (by - cy) * inverse, (cy - ay) * inverse, (cx - bx) * inverse, (ax - cx) * inverse


@kernel(fastmath=True, inline="always")
def border(weight, across, down):  # type: ignore[no-untyped-def]
    """Where a weight that grows by `across` and `down` is zero, as a border on the left and one on the right.

    Each is a column in the first row and its gain by the next row; that on the left is negated. The side without a
    border gets one that is far off.
    """
    if across > TINY:
        return (weight / across, down / across), (FAR, ZERO)
    across = min(across, -TINY)
    return (FAR, ZERO), (-weight / across, -down / across)


@kernel(fastmath=True, inline="always")
def span(row, count, lefts, rights):  # type: ignore[no-untyped-def]
    """The first column in a row of a triangle and the one after the last, of 0 to count - 1.

    Both ends reach a hundredth further, which closes the seam between neighbours. Borders are negated for `min`:
    `max` compiles to far slower code.
    """
    (a, da), (b, db), (c, dc) = lefts
    first = F(0.99) - min(min(a + row * da, b + row * db), c + row * dc)
    (a, da), (b, db), (c, dc) = rights
    last = F(1.01) + min(min(a + row * da, b + row * db), c + row * dc)
    return max(0, int(first)), min(count, int(last))


@kernel(fastmath=True, inline="always")
def repeated(place):  # type: ignore[no-untyped-def]
    """A coordinate of a picture, which repeats, as one in 0 to 1."""
    return place - F(int(place + REPEATS) - int(REPEATS))


@kernel(fastmath=True)
def farthest(depth, box, tiles):  # type: ignore[no-untyped-def]
    """Fill `tiles` with the least nearness in each whole square of `TILE` samples in `box`."""
    left, top, right, bottom = U(box[0]), U(box[1]), U(box[2]), U(box[3])
    for row in range((bottom - top) // TILE):
        for column in range((right - left) // TILE):
            y, x, least = top + TILE * row, left + TILE * column, FAR
            for i in range(TILE):
                for j in range(TILE):
                    least = min(least, depth[y + i, x + j])
            tiles[row, column] = least


@kernel(fastmath=True, inline="always")
def is_hidden(near, left, top, right, bottom, tiles):  # type: ignore[no-untyped-def]
    """Whether all that is drawn already in a box is nearer."""
    for row in range(U(top) // TILE, U(bottom - 1) // TILE + U(1)):
        for column in range(U(left) // TILE, U(right - 1) // TILE + U(1)):
            if near > tiles[row, column]:
                return False
    return True


@kernel(fastmath=True)
def visible(screen, triangles, depth, ids, box, uvs, two_sided, cutouts, sheer, texels, table):  # type: ignore[no-untyped-def]
    """Fill `depth` (h, w; nearness 1/z) and `ids` (h, w; triangle or -1) inside `box`, which holds all of `screen`.

    Back faces are drawn last: most are inside the body, behind front faces.

    `two_sided` (f) triangles are seen from both sides. `cutouts` (f) is the row of the picture that hides a triangle
    where its alpha is below a half, or -1. A `sheer` (f) one is seen in as many of four samples as its alpha says.
    """
    left, top, right, bottom = box
    if left >= right or top >= bottom:
        return
    depth[top:bottom, left:right] = ZERO
    ids[top:bottom, left:right] = -1
    tiles = np.zeros((U(bottom - top) // TILE + U(1), U(right - left) // TILE + U(1)), np.float32)
    late, others = np.empty(triangles.shape[0], np.uint32), U(0)
    for is_late in range(2):
        if is_late:
            farthest(depth, box, tiles)
        for i in range(others if is_late else U(triangles.shape[0])):
            t = U(late[i]) if is_late else i
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            ax, ay, bx, by, cx, cy = screen[a, 0], screen[a, 1], screen[b, 0], screen[b, 1], screen[c, 0], screen[c, 1]
            area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
            if area == ZERO or (area > ZERO and not two_sided[t]):  # y points down: triangles that face us turn left
                continue
            if not is_late and area > ZERO:
                late[others] = t
                others += U(1)
                continue
            za, zb, zc = screen[a, 2], screen[b, 2], screen[c, 2]
            if min(za, zb, zc) <= ZERO:
                continue
            first, behind = centres(min(ax, bx, cx), max(ax, bx, cx), left, right)
            low, under = centres(min(ay, by, cy), max(ay, by, cy), top, bottom)
            if first >= behind or low >= under:
                continue
            if is_late and is_hidden(max(za, zb, zc), first - left, low - top, behind - left, under - top, tiles):
                continue
            u, v, du, dv, eu, ev = barycentric(ax, ay, bx, by, cx, cy, area, first, low)
            lu, ru = border(u, du, eu)
            lv, rv = border(v, dv, ev)
            lw, rw = border(ONE - u - v, -du - dv, -eu - ev)
            nearness = zc + u * (za - zc) + v * (zb - zc)
            across, down = du * (za - zc) + dv * (zb - zc), eu * (za - zc) + ev * (zb - zc)
            picture = cutouts[t]
            start, wide, tall = 0, 1, 1
            if picture >= 0:
                start, wide, tall = table[picture, 1, 0], table[picture, 1, 1], table[picture, 1, 2]
            for row in range(low, under):
                r = F(row - low)
                begin, end = span(r, behind - first, (lu, lv, lw), (ru, rv, rw))
                near = nearness + r * down + F(begin) * across
                for k in range(begin, end):
                    column = first + k
                    if near > depth[row, column]:
                        is_clear = False
                        if picture >= 0:
                            p, q = u + r * eu + F(k) * du, v + r * ev + F(k) * dv
                            o = ONE - p - q
                            i = int(repeated(p * uvs[a, 0] + q * uvs[b, 0] + o * uvs[c, 0]) * F(wide))
                            j = int(repeated(p * uvs[a, 1] + q * uvs[b, 1] + o * uvs[c, 1]) * F(tall))
                            texel = start + min(tall - 1, max(0, j)) * wide + min(wide - 1, max(0, i))
                            least = 32 + 64 * (2 * (row & 1) + (column & 1)) if sheer[t] else 128
                            is_clear = texels[texel, 3] < least
                        if not is_clear:
                            depth[row, column] = near
                            ids[row, column] = t
                    near += across


@kernel(fastmath=True)
def shadow_depth(points, triangles, two_sided, to_light, light, shadow):  # type: ignore[no-untyped-def]
    """Fill `shadow` with the height towards the light of the highest surface over each texel.

    `to_light` (3, 4) maps metres to texels and height; `light` (v, 3) receives the points there.
    """
    size = shadow.shape[0]
    for v in range(points.shape[0]):
        for i in range(3):
            light[v, i] = (
                to_light[i, 0] * points[v, 0]
                + to_light[i, 1] * points[v, 1]
                + to_light[i, 2] * points[v, 2]
                + to_light[i, 3]
            )
    shadow[:, :] = F(-1e9)
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = light[a, 0], light[a, 1], light[b, 0], light[b, 1], light[c, 0], light[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == ZERO or (area < ZERO and not two_sided[t]):  # hidden by a surface that faces the light
            continue
        first, behind = centres(min(ax, bx, cx), max(ax, bx, cx), 0, size)
        low, under = centres(min(ay, by, cy), max(ay, by, cy), 0, size)
        if first >= behind or low >= under:
            continue
        u, v, du, dv, eu, ev = barycentric(ax, ay, bx, by, cx, cy, area, first, low)
        lu, ru = border(u, du, eu)
        lv, rv = border(v, dv, ev)
        lw, rw = border(ONE - u - v, -du - dv, -eu - ev)
        ha, hb, hc = light[a, 2], light[b, 2], light[c, 2]
        top = hc + u * (ha - hc) + v * (hb - hc)
        across, down = du * (ha - hc) + dv * (hb - hc), eu * (ha - hc) + ev * (hb - hc)
        for row in range(low, under):
            r = F(row - low)
            begin, end = span(r, behind - first, (lu, lv, lw), (ru, rv, rw))
            height = top + r * down + F(begin) * across
            for k in range(begin, end):
                shadow[row, first + k] = max(height, shadow[row, first + k])
                height += across
