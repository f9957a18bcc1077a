"""Which triangle is seen in each sample of a picture, and how high the surface is from the light.

One picture is drawn by one thread; two threads draw two pictures. Every loop stays inside the box of what it draws.
Constants are float32, or numba would compute in double precision.
"""

import math

import numpy as np

from echoavatar.nn.kernels import kernel

F = np.float32
ZERO, ONE, HALF = F(0.0), F(1.0), F(0.5)


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
    """The pixels around the points before the camera: left, top, and right, bottom, which are not included."""
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


@kernel(fastmath=True)
def visible(screen, triangles, depth, ids, box, uvs, pictures, cutouts, texels, table):  # type: ignore[no-untyped-def]
    """Fill `depth` (h, w; nearness 1/z) and `ids` (h, w; triangle or -1) inside `box`, which holds all of `screen`.

    Triangles with `cutouts` (f) are seen from both sides, and only where the alpha of their picture is a half or more.
    """
    left, top, right, bottom = box
    for row in range(top, bottom):
        for column in range(left, right):
            depth[row, column] = ZERO
            ids[row, column] = -1
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = screen[a, 0], screen[a, 1], screen[b, 0], screen[b, 1], screen[c, 0], screen[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == ZERO or (area > ZERO and not cutouts[t]):  # y points down: triangles that face us turn left
            continue
        za, zb, zc = screen[a, 2], screen[b, 2], screen[c, 2]
        if min(za, zb, zc) <= ZERO:
            continue
        first = max(left, int(math.ceil(min(ax, bx, cx) - HALF)))
        last = min(right - 1, int(math.floor(max(ax, bx, cx) - HALF)))
        if first > last:
            continue
        low = max(top, int(math.ceil(min(ay, by, cy) - HALF)))
        high = min(bottom - 1, int(math.floor(max(ay, by, cy) - HALF)))
        picture = pictures[t] if cutouts[t] else -1
        inverse = ONE / area
        du, dv = (by - cy) * inverse, (cy - ay) * inverse  # from one column to the next
        for row in range(low, high + 1):
            x, y = F(first) + HALF, F(row) + HALF
            u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) * inverse
            v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) * inverse
            for column in range(first, last + 1):
                w = ONE - u - v
                if u >= ZERO and v >= ZERO and w >= ZERO:
                    near = u * za + v * zb + w * zc
                    if near > depth[row, column]:
                        is_clear = False
                        if picture >= 0:
                            start, wide, tall = table[picture, 1, 0], table[picture, 1, 1], table[picture, 1, 2]
                            tu = int((u * uvs[a, 0] + v * uvs[b, 0] + w * uvs[c, 0]) * F(wide))
                            tv = int((u * uvs[a, 1] + v * uvs[b, 1] + w * uvs[c, 1]) * F(tall))
                            texel = start + min(tall - 1, max(0, tv)) * wide + min(wide - 1, max(0, tu))
                            is_clear = texels[texel, 3] < 128
                        if not is_clear:
                            depth[row, column] = near
                            ids[row, column] = t
                u += du
                v += dv


@kernel(fastmath=True)
def shadow_depth(points, triangles, cutouts, to_light, light, shadow):  # type: ignore[no-untyped-def]
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
        if area == ZERO or (area < ZERO and not cutouts[t]):  # what faces away is hidden by what faces the light
            continue
        first = max(0, int(math.ceil(min(ax, bx, cx) - HALF)))
        last = min(size - 1, int(math.floor(max(ax, bx, cx) - HALF)))
        if first > last:
            continue
        low = max(0, int(math.ceil(min(ay, by, cy) - HALF)))
        high = min(size - 1, int(math.floor(max(ay, by, cy) - HALF)))
        inverse = ONE / area
        du, dv = (by - cy) * inverse, (cy - ay) * inverse  # from one column to the next
        hc = light[c, 2]
        ha, hb = light[a, 2] - hc, light[b, 2] - hc
        for row in range(low, high + 1):
            x, y = F(first) + HALF, F(row) + HALF
            u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) * inverse
            v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) * inverse
            for column in range(first, last + 1):
                if u >= ZERO and v >= ZERO and u + v <= ONE:
                    height = u * ha + v * hb + hc
                    if height > shadow[row, column]:
                        shadow[row, column] = height
                u += du
                v += dv
