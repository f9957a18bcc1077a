"""The light on the body, sample by sample at its edges and once a pixel elsewhere, and its shadow on the floor.

Every other pixel keeps the backdrop. Constants are float32, or numba would compute in double precision. The body's
samples are lit in batches, one step after the other, so that the processor computes several of them at once.
"""

import math

import numpy as np

from echoavatar.nn.kernels import kernel

from .raster import HALF, ONE, TINY, ZERO, F, U, repeated

BLUR = F(2.5)  # a sample that covers more texels reads the next mip level
FADE_METRES = F(2.6)  # distance from the body at which its shadow on the floor is gone
BATCH = 496  # samples that are lit at once; of a power of two, rows would lie in the same lines of the cache
WHOLE = -1  # count of a pixel whose samples are lit as one
# Rows of a batch: what is interpolated between vertices, and what is computed from it and takes its place.
POINT, NORMAL, COLOUR, UV, COVERED, AMBIENT, ROWS = 0, 3, 6, 9, 11, 12, 15
TEXEL, KEY, SHINE, PAINT = POINT, NORMAL, NORMAL + 1, UV


@kernel(fastmath=True, inline="always")
def lit(u, v, height, shadow):  # type: ignore[no-untyped-def]
    """Share of the key light that reaches a height over a place in texels: 3 x 3 taps of the shadow map.

    If the corners and the middle of the window agree, the other taps are not read.
    """
    size = shadow.shape[0]
    column, row = int(u - HALF), int(v - HALF)
    if column < 1 or row < 1 or column >= size - 2 or row >= size - 2:
        return ONE
    corners = 0
    for dy in range(-1, 3, 3):
        for dx in range(-1, 3, 3):
            corners += shadow[U(row + dy), U(column + dx)] <= height
    corners += shadow[U(row), U(column)] <= height
    if corners == 5:
        return ONE
    if corners == 0:
        return ZERO
    fu, fv = u - HALF - F(column), v - HALF - F(row)
    total = ZERO  # without branches: at a shadow's edge they would be guessed wrongly
    for dy in range(4):
        weight = ONE - fv if dy == 0 else fv if dy == 3 else ONE
        line = shadow[U(row - 1 + dy)]
        ends = (ONE - fu) * F(line[U(column - 1)] <= height) + fu * F(line[U(column + 2)] <= height)
        total += weight * (ends + F(line[U(column)] <= height) + F(line[U(column + 1)] <= height))
    return total / F(9.0)


@kernel(fastmath=True, inline="always")
def wrapped(index, count):  # type: ignore[no-untyped-def]
    """An index from -1 to count, moved into 0 to count - 1."""
    return count - 1 if index < 0 else 0 if index >= count else index


@kernel(fastmath=True, inline="always")
def sampled(texels, table, to_linear, picture, level, x, y):  # type: ignore[no-untyped-def]
    """Linear colour of a picture at (x, y), which may repeat, between the four texels around."""
    start, wide, high = table[picture, level, 0], table[picture, level, 1], table[picture, level, 2]
    x, y = repeated(x) * F(wide) + HALF, repeated(y) * F(high) + HALF
    right, lower = int(x), int(y)
    fx, fy = x - F(right), y - F(lower)
    red, green, blue = ZERO, ZERO, ZERO
    for dy in range(2):
        for dx in range(2):
            share = (fx if dx else ONE - fx) * (fy if dy else ONE - fy)
            texel = texels[U(start + wrapped(lower + dy - 1, high) * wide + wrapped(right + dx - 1, wide))]
            red += share * to_linear[texel[0]]
            green += share * to_linear[texel[1]]
            blue += share * to_linear[texel[2]]
    return red, green, blue


@kernel(fastmath=True, inline="always")
def chosen(row, left, right, samples, ids, depth, sheer, xs, ys, ts, counts, batch):  # type: ignore[no-untyped-def]
    """List the samples to be lit in a row of pixels, their triangles, and the area that each stands for.

    Returns how many there are; `counts` receives those of each pixel. Samples that see the same stretch of surface are
    lit once, unless it is `sheer` (f).
    """
    n = U(0)
    for column in range(left, right):
        nearest, farthest = ZERO, F(1e9)
        for y in range(row * samples, (row + U(1)) * samples):
            for x in range(column * samples, (column + U(1)) * samples):
                nearest, farthest = max(nearest, depth[y, x]), min(farthest, depth[y, x])
        counts[column - left] = 0
        if nearest == ZERO:
            continue
        is_mixed = nearest - farthest >= F(0.004) * nearest
        if not is_mixed:
            for y in range(row * samples, (row + U(1)) * samples):
                for x in range(column * samples, (column + U(1)) * samples):
                    is_mixed |= sheer[U(ids[y, x])]
        first, wanted = n, samples if is_mixed else U(1)
        for y in range(row * samples, row * samples + wanted):
            for x in range(column * samples, column * samples + wanted):
                if ids[y, x] >= 0:
                    xs[n], ys[n], ts[n] = x, y, ids[y, x]
                    batch[COVERED, n] = ONE if is_mixed else F(samples * samples)
                    n += U(1)
        counts[column - left] = np.int32(n - first) if is_mixed else WHOLE
    return n


@kernel(fastmath=True, inline="always")
def interpolated(  # type: ignore[no-untyped-def]
    n, xs, ys, ts, depth, screen, points, normals, colours, uvs, triangles, spreads, batch
):
    """Fill the batch's first rows: the vertices' values at each sample, and how many texels it covers."""
    for e in range(n):
        t = U(ts[e])
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        px, py = F(xs[e]) + HALF, F(ys[e]) + HALF
        ax, ay, bx, by, cx, cy = screen[a, 0], screen[a, 1], screen[b, 0], screen[b, 1], screen[c, 0], screen[c, 1]
        inverse, near = ONE / ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)), ONE / depth[ys[e], xs[e]]
        u = ((bx - px) * (cy - py) - (cx - px) * (by - py)) * inverse
        v = ((cx - px) * (ay - py) - (ax - px) * (cy - py)) * inverse
        w = (ONE - u - v) * screen[c, 2] * near
        u, v = u * screen[a, 2] * near, v * screen[b, 2] * near
        for i in range(3):
            batch[POINT + i, e] = u * points[a, i] + v * points[b, i] + w * points[c, i]
            batch[NORMAL + i, e] = u * normals[a, i] + v * normals[b, i] + w * normals[c, i]
            batch[COLOUR + i, e] = u * colours[a, i] + v * colours[b, i] + w * colours[c, i]
        for i in range(2):
            batch[UV + i, e] = u * uvs[a, i] + v * uvs[b, i] + w * uvs[c, i]
        batch[COVERED, e] *= abs(inverse) * spreads[t]


@kernel(fastmath=True, inline="always")
def illuminated(n, camera, to_light, look, batch):  # type: ignore[no-untyped-def]
    """Light before shadows: place in the shadow map, key light, cosine to the highlight, and all other light."""
    lx, ly, lz = look[0, 0], look[0, 1], look[0, 2]
    for e in range(n):
        x, y, z = batch[POINT, e], batch[POINT + 1, e], batch[POINT + 2, e]
        nx, ny, nz = batch[NORMAL, e], batch[NORMAL + 1, e], batch[NORMAL + 2, e]
        scale = ONE / math.sqrt(nx * nx + ny * ny + nz * nz + F(1e-12))
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        dx, dy, dz = x - camera[0], y - camera[1], z - camera[2]
        scale = ONE / math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * scale, dy * scale, dz * scale
        hx, hy, hz = lx - dx, ly - dy, lz - dz
        h = ONE / math.sqrt(hx * hx + hy * hy + hz * hz + F(1e-12))
        behind = max(ZERO, nx * look[4, 0] + ny * look[4, 1] + nz * look[4, 2])
        up = HALF + HALF * ny
        facing = max(ZERO, ONE + nx * dx + ny * dy + nz * dz)
        sheen = facing * facing * facing * F(0.18) * up
        near_floor = min(ONE, F(0.55) + y * F(0.9))
        x, y, z = x + nx * F(0.012), y + ny * F(0.012), z + nz * F(0.012)
        for i in range(3):
            around = (look[3, i] + (look[2, i] - look[3, i]) * up) * near_floor
            batch[AMBIENT + i, e] = look[5, i] * behind + around + sheen
            batch[TEXEL + i, e] = to_light[i, 0] * x + to_light[i, 1] * y + to_light[i, 2] * z + to_light[i, 3]
        batch[KEY, e] = max(ZERO, (nx * lx + ny * ly + nz * lz + F(0.12)) / F(1.12))
        batch[SHINE, e] = max(ZERO, (nx * hx + ny * hy + nz * hz) * h)


@kernel(fastmath=True, inline="always")
def painted(n, ts, shadow, glosses, pictures, texels, table, to_linear, batch):  # type: ignore[no-untyped-def]
    """Take the shadow from the key light, make the highlight of its cosine, and look up the colour of the picture."""
    for e in range(n):
        t = U(ts[e])
        if batch[KEY, e] > ZERO:
            batch[KEY, e] *= lit(batch[TEXEL, e], batch[TEXEL + 1, e], batch[TEXEL + 2, e] + F(0.008), shadow)
        shine = glosses[t, 0] * batch[KEY, e]
        if shine > F(2e-3):
            shine *= batch[SHINE, e] ** glosses[t, 1]
        batch[SHINE, e] = shine
        red, green, blue = ONE, ONE, ONE
        if pictures[t] >= 0:
            level, covered = 0, batch[COVERED, e]
            while covered > BLUR and level < table.shape[1] - 1:
                level, covered = level + 1, covered * F(0.25)
            x, y = batch[UV, e], batch[UV + 1, e]
            red, green, blue = sampled(texels, table, to_linear, U(pictures[t]), U(level), x, y)
        batch[PAINT, e], batch[PAINT + 1, e], batch[PAINT + 2, e] = red, green, blue


@kernel(fastmath=True, inline="always")
def summed(n, look, batch):  # type: ignore[no-untyped-def]
    """All light times colour and picture, as places in the tone curve, in the batch's first rows."""
    for e in range(n):
        for i in range(3):
            light = look[1, i] * batch[KEY, e] + batch[AMBIENT + i, e]
            value = light * batch[COLOUR + i, e] * batch[PAINT + i, e] + batch[SHINE, e]
            batch[i, e] = min(F(4095.0), value * F(1024.0))


@kernel(fastmath=True, inline="always")
def toned(place, tone):  # type: ignore[no-untyped-def]
    """Look a place up in the tone curve; it need not be finite."""
    return F(tone[U(min(4095, max(0, int(place))))])


@kernel(fastmath=True, inline="always")
def mixed(row, left, right, samples, counts, batch, tone, image):  # type: ignore[no-untyped-def]
    """Write a row of pixels: means of their samples through the tone curve, over what is there."""
    e, has_alpha = U(0), image.shape[2] == 4
    for column in range(left, right):
        count = counts[column - left]
        if count == 0:
            continue
        pixel, r, g, b = image[row, column], ZERO, ZERO, ZERO
        for _ in range(abs(count)):
            r, g, b = r + toned(batch[0, e], tone), g + toned(batch[1, e], tone), b + toned(batch[2, e], tone)
            e += U(1)
        if count == WHOLE and not has_alpha:
            pixel[0], pixel[1], pixel[2] = r, g, b
            continue
        share = ONE if count == WHOLE else F(samples * samples)
        empty = share - F(abs(count))
        under = F(pixel[3]) / F(255.0) if has_alpha else ONE
        weight = share - empty + empty * under  # of all that is not clear
        pixel[0] = (r + empty * under * F(pixel[0])) / weight + HALF
        pixel[1] = (g + empty * under * F(pixel[1])) / weight + HALF
        pixel[2] = (b + empty * under * F(pixel[2])) / weight + HALF
        if has_alpha:
            pixel[3] = F(255.0) * weight / share + HALF


@kernel(fastmath=True)
def floor_shadow(  # type: ignore[no-untyped-def]
    image, box, samples, camera, rays, middle, to_light, reach, shadow, contact, contact_map, strength
):
    """Darken the floor in `box` by the key light's shadow and by the nearness of the body (`contact`, n x n).

    `reach` (2) are the shadow map's columns between which there is shadow; `contact_map` (2, 2) holds scale and shift
    from metres (x, z) to cells. A fourth channel becomes opaque instead. Returns the first column and the one after the
    last that may have changed.
    """
    left, top, right, bottom = box
    least, most = right, left
    cells = contact.shape[0]
    has_alpha = image.shape[2] == 4
    along, past = rays[1, 0], rays[1, 2]  # a row of the picture is level: what it gains by a column has no height
    for row in range(top, bottom):
        px, py = (F(left) + HALF) * F(samples), (F(row) + HALF) * F(samples)
        dy = rays[0, 1] + rays[2, 1] * py
        if dy > F(-1e-3):
            continue
        distance = -camera[1] / dy
        x0 = camera[0] + (rays[0, 0] + along * px + rays[2, 0] * py) * distance
        z0 = camera[2] + (rays[0, 2] + past * px + rays[2, 2] * py) * distance
        across, away = along * F(samples) * distance, past * F(samples) * distance
        u0 = to_light[0, 0] * x0 + to_light[0, 2] * z0 + to_light[0, 3]
        step = to_light[0, 0] * across + to_light[0, 2] * away
        step = step if abs(step) > TINY else TINY
        one, other = (reach[0] - u0) / step, (reach[1] - u0) / step
        begin, end = max(left, left + int(min(one, other))), min(right, left + int(max(one, other)) + 1)
        if begin < end:
            least, most = min(least, begin), max(most, end)
        for column in range(begin, end):
            x, z = x0 + F(column - left) * across, z0 + F(column - left) * away
            fading = ONE - ((x - middle[0]) ** 2 + (z - middle[1]) ** 2) * (ONE / FADE_METRES**2)
            if fading <= ZERO:
                continue
            sv = to_light[1, 0] * x + to_light[1, 2] * z + to_light[1, 3]
            height = to_light[2, 0] * x + to_light[2, 2] * z + to_light[2, 3] + F(0.004)
            dark = strength[0] * (ONE - lit(u0 + F(column - left) * step, sv, height, shadow)) * fading
            u, v = x * contact_map[0, 0] + contact_map[0, 1], z * contact_map[1, 0] + contact_map[1, 1]
            i, j = int(u), int(v)
            if u >= ZERO and v >= ZERO and i < cells - 1 and j < cells - 1:
                fu, fv = u - F(i), v - F(j)
                upper = contact[j, i] * (ONE - fu) + contact[j, i + 1] * fu
                lower = contact[j + 1, i] * (ONE - fu) + contact[j + 1, i + 1] * fu
                dark = ONE - (ONE - dark) * (ONE - strength[1] * (upper * (ONE - fv) + lower * fv))
            if dark <= ZERO:
                continue
            if has_alpha:
                image[row, column, 3] = F(255.0) * dark
            else:
                for channel in range(3):
                    image[row, column, channel] = F(image[row, column, channel]) * (ONE - dark) + HALF
    return min(least, most), most


@kernel(fastmath=True)
def softened(cells):  # type: ignore[no-untyped-def]
    """Blur `cells` (n, n), thrice: means of nine cells along each axis. Cells beyond the edge count as 0.

    A matrix product would be shorter, but its idle threads would take processor time from those that draw.
    """
    count, line = cells.shape[0], np.empty(cells.shape[0], np.float32)
    for _ in range(2):
        for row in range(count):
            for _ in range(3):
                line[:] = cells[row]
                total = ZERO
                for at in range(count + 4):
                    if at < count:
                        total += line[at]
                    if at >= 9:
                        total -= line[at - 9]
                    if at >= 4:
                        cells[row, at - 4] = max(ZERO, total) / F(9.0)
        cells[:, :] = cells.T.copy()


@kernel(fastmath=True)
def nearness(points, contact, contact_map):  # type: ignore[no-untyped-def]
    """Fill `contact` (n, n) with the nearness of the body above each cell of the floor: 1 on it, 0 from 35 cm on."""
    cells = contact.shape[0]
    contact[:, :] = ZERO
    for v in range(points.shape[0]):
        y = points[v, 1]
        if y < F(0.35):
            i = int(points[v, 0] * contact_map[0, 0] + contact_map[0, 1])
            j = int(points[v, 2] * contact_map[1, 0] + contact_map[1, 1])
            if i >= 0 and j >= 0 and i < cells and j < cells:
                near = ONE - max(ZERO, y) / F(0.35)
                contact[j, i] = max(contact[j, i], near * near)


@kernel(fastmath=True)
def shade(  # type: ignore[no-untyped-def]
    screen, points, normals, colours, uvs, triangles, ids, depth, box, samples, camera, to_light, shadow, look, tone,
    image, pictures, spreads, glosses, sheer, texels, table, to_linear,
):  # fmt: skip
    """Draw the body on `image` (h, w, 3 or 4) uint8 from `samples` x `samples` visibility samples a pixel, in `box`.

    `pictures` (f), `spreads` (f) and `glosses` (f, 2) are the picture (or -1), twice its texels and the highlights of
    each triangle. `look` rows: light direction, key light, sky, ground, direction and colour of the light from behind.
    """
    samples = U(samples)
    left, top, right, bottom = U(box[0]), U(box[1]), U(box[2]), U(box[3])
    size = max(U(BATCH), samples * samples)
    xs, ys, ts = np.empty(size, np.uint32), np.empty(size, np.uint32), np.empty(size, np.uint32)
    batch, counts = np.empty((ROWS, size), np.float32), np.empty(size, np.int32)
    pixels = size // (samples * samples)
    for row in range(top // samples, bottom // samples):
        for begin in range(left // samples, right // samples, pixels):
            end = min(right // samples, begin + pixels)
            n = chosen(row, begin, end, samples, ids, depth, sheer, xs, ys, ts, counts, batch)
            interpolated(n, xs, ys, ts, depth, screen, points, normals, colours, uvs, triangles, spreads, batch)
            illuminated(n, camera, to_light, look, batch)
            painted(n, ts, shadow, glosses, pictures, texels, table, to_linear, batch)
            summed(n, look, batch)
            mixed(row, begin, end, samples, counts, batch, tone, image)
