"""The inner loops of the renderer, compiled by numba: visibility, shadow, shading.

Two passes: which triangle is seen in each pixel, then light for the pixels that see one; every other pixel sees the
floor plane or the backdrop.
Constants are float32, or numba would compute in double precision.
"""

import math

import numpy as np
from numba import prange

from echoavatar.nn.kernels import kernel

F = np.float32
ZERO, ONE, HALF = F(0.0), F(1.0), F(0.5)
BANDS = 16


@kernel(fastmath=True, parallel=True)
def visible(screen, triangles, depth, ids, uvs, pictures, cutouts, texels, table):  # type: ignore[no-untyped-def]
    """Fill `depth` (h, w; nearness 1/z) and `ids` (h, w; triangle or -1) from `screen` (v, 3): x, y in pixels, 1/z.

    Triangles with `cutouts` (f) are seen from both sides, and only where the alpha of their picture is a half or more.
    """
    height, width = depth.shape
    for band in prange(BANDS):
        top, bottom = band * height // BANDS, (band + 1) * height // BANDS
        for row in range(top, bottom):
            for column in range(width):
                depth[row, column] = ZERO
                ids[row, column] = -1
        for t in range(triangles.shape[0]):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            ax, ay, bx, by, cx, cy = (
                screen[a, 0],
                screen[a, 1],
                screen[b, 0],
                screen[b, 1],
                screen[c, 0],
                screen[c, 1],
            )
            if min(screen[a, 2], screen[b, 2], screen[c, 2]) <= ZERO:
                continue
            area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
            if area == ZERO or (area > ZERO and not cutouts[t]):  # y points down: triangles that face us turn left
                continue
            picture = pictures[t] if cutouts[t] else -1
            low = max(top, int(math.floor(min(ay, by, cy))))
            high = min(bottom - 1, int(math.ceil(max(ay, by, cy))))
            left = max(0, int(math.floor(min(ax, bx, cx))))
            right = min(width - 1, int(math.ceil(max(ax, bx, cx))))
            inverse = ONE / area
            for row in range(low, high + 1):
                y = F(row) + HALF
                for column in range(left, right + 1):
                    x = F(column) + HALF
                    u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) * inverse
                    v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) * inverse
                    w = ONE - u - v
                    if u >= ZERO and v >= ZERO and w >= ZERO:
                        near = u * screen[a, 2] + v * screen[b, 2] + w * screen[c, 2]
                        if near > depth[row, column]:
                            if picture >= 0:
                                start, wide, tall = table[picture, 1, 0], table[picture, 1, 1], table[picture, 1, 2]
                                tu = int((u * uvs[a, 0] + v * uvs[b, 0] + w * uvs[c, 0]) * F(wide))
                                tv = int((u * uvs[a, 1] + v * uvs[b, 1] + w * uvs[c, 1]) * F(tall))
                                texel = start + min(tall - 1, max(0, tv)) * wide + min(wide - 1, max(0, tu))
                                if texels[texel, 3] < 128:
                                    continue
                            depth[row, column] = near
                            ids[row, column] = t


@kernel(fastmath=True)
def shadow_depth(light, triangles, shadow):  # type: ignore[no-untyped-def]
    """Height above the light's far plane seen from the light; `light` (v, 3): x, y in texels, height towards it."""
    size = shadow.shape[0]
    shadow[:, :] = F(-1e9)
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = light[a, 0], light[a, 1], light[b, 0], light[b, 1], light[c, 0], light[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == ZERO:
            continue
        inverse = ONE / area
        for row in range(max(0, int(min(ay, by, cy))), min(size - 1, int(max(ay, by, cy)) + 1) + 1):
            for column in range(max(0, int(min(ax, bx, cx))), min(size - 1, int(max(ax, bx, cx)) + 1) + 1):
                x, y = F(column) + HALF, F(row) + HALF
                u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) * inverse
                v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) * inverse
                w = ONE - u - v
                if u >= ZERO and v >= ZERO and w >= ZERO:
                    height = u * light[a, 2] + v * light[b, 2] + w * light[c, 2]
                    if height > shadow[row, column]:
                        shadow[row, column] = height


@kernel(fastmath=True, inline="always")
def lit(x, y, z, to_light, shadow, bias):  # type: ignore[no-untyped-def]
    """Share of the key light that reaches a point: 5 x 5 taps of the shadow map; `to_light` (3, 4) maps to texels.

    Where the corners and the middle of the window agree, they decide alone.
    """
    u = to_light[0, 0] * x + to_light[0, 1] * y + to_light[0, 2] * z + to_light[0, 3]
    v = to_light[1, 0] * x + to_light[1, 1] * y + to_light[1, 2] * z + to_light[1, 3]
    height = to_light[2, 0] * x + to_light[2, 1] * y + to_light[2, 2] * z + to_light[2, 3] + bias
    size = shadow.shape[0]
    column, row = int(math.floor(u - HALF)), int(math.floor(v - HALF))
    if column < 3 or row < 3 or column >= size - 4 or row >= size - 4:
        return ONE
    corners = 0
    for dy in range(-2, 4, 5):
        for dx in range(-2, 4, 5):
            corners += shadow[row + dy, column + dx] <= height
    corners += shadow[row, column] <= height
    if corners == 5:
        return ONE
    if corners == 0:
        return ZERO
    fu, fv = u - HALF - F(column), v - HALF - F(row)
    total = ZERO
    for dy in range(-2, 4):
        wy = ONE
        if dy == -2:
            wy = ONE - fv
        elif dy == 3:
            wy = fv
        for dx in range(-2, 4):
            wx = ONE
            if dx == -2:
                wx = ONE - fu
            elif dx == 3:
                wx = fu
            if shadow[row + dy, column + dx] <= height:
                total += wx * wy
    return total / F(25.0)


@kernel(fastmath=True)
def sampled(texels, table, to_linear, picture, level, x, y):  # type: ignore[no-untyped-def]
    """Linear colour of a picture at (x, y), which may repeat, between the four texels around."""
    level = min(table.shape[1] - 1, max(0, level))
    start, wide, high = table[picture, level, 0], table[picture, level, 1], table[picture, level, 2]
    px, py = (x - math.floor(x)) * F(wide) - HALF, (y - math.floor(y)) * F(high) - HALF
    left, top = int(math.floor(px)), int(math.floor(py))
    fx, fy = F(px - left), F(py - top)
    red, green, blue = ZERO, ZERO, ZERO
    for dy in range(2):
        for dx in range(2):
            share = (fx if dx else ONE - fx) * (fy if dy else ONE - fy)
            texel = start + (top + dy) % high * wide + (left + dx) % wide
            red += share * to_linear[texels[texel, 0]]
            green += share * to_linear[texels[texel, 1]]
            blue += share * to_linear[texels[texel, 2]]
    return red, green, blue


@kernel(fastmath=True)
def body_light(u, v, w, t, ray, paint, gloss, points, normals, colours, triangles, to_light, shadow, look):  # type: ignore[no-untyped-def]
    """Linear colour of a point on the surface, barycentric (u, v, w) in triangle t, seen along `ray`.

    `paint` is the picture's colour there, `gloss` the strength and sharpness of highlights.
    """
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    dx, dy, dz = ray
    lx, ly, lz = look[0, 0], look[0, 1], look[0, 2]
    nx = u * normals[a, 0] + v * normals[b, 0] + w * normals[c, 0]
    ny = u * normals[a, 1] + v * normals[b, 1] + w * normals[c, 1]
    nz = u * normals[a, 2] + v * normals[b, 2] + w * normals[c, 2]
    n = ONE / math.sqrt(nx * nx + ny * ny + nz * nz + F(1e-12))
    nx, ny, nz = nx * n, ny * n, nz * n
    x = u * points[a, 0] + v * points[b, 0] + w * points[c, 0]
    y = u * points[a, 1] + v * points[b, 1] + w * points[c, 1]
    z = u * points[a, 2] + v * points[b, 2] + w * points[c, 2]
    light = max(ZERO, (nx * lx + ny * ly + nz * lz + F(0.12)) / F(1.12))
    if light > ZERO:
        light *= lit(x + nx * F(0.012), y + ny * F(0.012), z + nz * F(0.012), to_light, shadow, F(0.008))
    up = HALF + HALF * ny
    rim = max(ZERO, ONE + nx * dx + ny * dy + nz * dz)
    rim = rim * rim * rim * F(0.22) * up
    hx, hy, hz = lx - dx, ly - dy, lz - dz
    h = ONE / math.sqrt(hx * hx + hy * hy + hz * hz + F(1e-12))
    shine = max(ZERO, (nx * hx + ny * hy + nz * hz) * h) ** gloss[1] * gloss[0] * light
    near_floor = min(ONE, F(0.55) + y * F(0.9))
    red = (
        paint[0]
        * (u * colours[a, 0] + v * colours[b, 0] + w * colours[c, 0])
        * (look[1, 0] * light + (look[3, 0] + (look[2, 0] - look[3, 0]) * up) * near_floor + rim)
    )
    green = (
        paint[1]
        * (u * colours[a, 1] + v * colours[b, 1] + w * colours[c, 1])
        * (look[1, 1] * light + (look[3, 1] + (look[2, 1] - look[3, 1]) * up) * near_floor + rim)
    )
    blue = (
        paint[2]
        * (u * colours[a, 2] + v * colours[b, 2] + w * colours[c, 2])
        * (look[1, 2] * light + (look[3, 2] + (look[2, 2] - look[3, 2]) * up) * near_floor + rim)
    )
    return red + shine, green + shine, blue + shine


@kernel(fastmath=True)
def floor_light(ray, camera, to_light, shadow, look):  # type: ignore[no-untyped-def]
    """Linear colour where a ray meets no triangle: floor with shadow and one-metre grid, fading into the backdrop."""
    dx, dy, dz = ray
    fade, bright, line = ZERO, ONE, ZERO
    if dy < F(-1e-3):
        distance = -camera[1] / dy
        x, z = camera[0] + dx * distance, camera[2] + dz * distance
        fade = max(ZERO, ONE - math.sqrt(x * x + z * z) / F(7.0))
        fade = fade * fade * (F(3.0) - F(2.0) * fade)
        bright = F(0.45) + F(0.55) * lit(x, ZERO, z, to_light, shadow, F(0.004))
        gx, gz = abs(x - math.floor(x + HALF)), abs(z - math.floor(z + HALF))
        thin = F(0.0015) * distance + F(0.003)
        line = max(max(ZERO, ONE - gx / thin), max(ZERO, ONE - gz / thin)) * F(0.12)
    rise = F(0.75) + F(0.5) * (HALF + HALF * dy)
    ground = bright * (ONE - line)
    red = look[5, 0] * rise + (look[4, 0] * ground - look[5, 0] * rise) * fade
    green = look[5, 1] * rise + (look[4, 1] * ground - look[5, 1] * rise) * fade
    blue = look[5, 2] * rise + (look[4, 2] * ground - look[5, 2] * rise) * fade
    return red, green, blue


@kernel(fastmath=True, inline="always")
def toned(value, tone):  # type: ignore[no-untyped-def]
    """Look one linear value up in the tone curve."""
    return F(tone[min(4095, max(0, int(value * F(1024.0))))])


@kernel(fastmath=True, inline="always")
def ray_through(rays, px, py):  # type: ignore[no-untyped-def]
    """Unit direction of the ray through a (supersampled) pixel."""
    dx = rays[0, 0] + rays[1, 0] * px + rays[2, 0] * py
    dy = rays[0, 1] + rays[1, 1] * px + rays[2, 1] * py
    dz = rays[0, 2] + rays[1, 2] * px + rays[2, 2] * py
    scale = ONE / math.sqrt(dx * dx + dy * dy + dz * dz)
    return dx * scale, dy * scale, dz * scale


@kernel(fastmath=True, parallel=True)
def shade(  # type: ignore[no-untyped-def]
    screen, points, normals, colours, triangles, ids, depth, samples, camera, rays, to_light, shadow, look, tone, image,
    uvs, pictures, glosses, texels, table, to_linear,
):  # fmt: skip
    """Colour every pixel of `image` (h, w, 3) uint8 from `samples` x `samples` visibility samples each.

    `pictures` (f) and `glosses` (f, 2) are the picture (or -1) and the highlights of each triangle.
    `look` rows: light direction, key light, sky, ground, floor, backdrop. Samples that see the same stretch of surface
    (or none) are lit once.
    """
    height, width = image.shape[0], image.shape[1]
    for row in prange(height):
        for column in range(width):
            empty = True
            nearest, farthest = ZERO, F(1e9)
            for sy in range(samples):
                for sx in range(samples):
                    if ids[row * samples + sy, column * samples + sx] >= 0:
                        empty = False
                    nearest = max(nearest, depth[row * samples + sy, column * samples + sx])
                    farthest = min(farthest, depth[row * samples + sy, column * samples + sx])
            if empty:
                ray = ray_through(rays, (F(column) + HALF) * F(samples), (F(row) + HALF) * F(samples))
                red, green, blue = floor_light(ray, camera, to_light, shadow, look)
                image[row, column, 0] = toned(red, tone)
                image[row, column, 1] = toned(green, tone)
                image[row, column, 2] = toned(blue, tone)
                continue
            r, g, b = ZERO, ZERO, ZERO
            wanted = 1 if nearest - farthest < F(0.004) * nearest else samples
            share = ONE / F(wanted * wanted)
            for sy in range(wanted):
                for sx in range(wanted):
                    y, x = row * samples + sy, column * samples + sx
                    px, py = F(x) + HALF, F(y) + HALF
                    ray = ray_through(rays, px, py)
                    t = ids[y, x]
                    if t < 0:
                        red, green, blue = floor_light(ray, camera, to_light, shadow, look)
                    else:
                        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
                        ax, ay, bx, by = screen[i, 0], screen[i, 1], screen[j, 0], screen[j, 1]
                        cx, cy = screen[k, 0], screen[k, 1]
                        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
                        u = ((bx - px) * (cy - py) - (cx - px) * (by - py)) / area
                        v = ((cx - px) * (ay - py) - (ax - px) * (cy - py)) / area
                        near = ONE / depth[y, x]
                        w = (ONE - u - v) * screen[k, 2] * near
                        u, v = u * screen[i, 2] * near, v * screen[j, 2] * near
                        paint = (ONE, ONE, ONE)
                        if pictures[t] >= 0:
                            picture = pictures[t]
                            flat = (uvs[j, 0] - uvs[i, 0]) * (uvs[k, 1] - uvs[i, 1])
                            flat -= (uvs[k, 0] - uvs[i, 0]) * (uvs[j, 1] - uvs[i, 1])
                            texel = abs(flat) * F(table[picture, 0, 1] * table[picture, 0, 2]) / abs(area)
                            texel *= F((samples * samples) // (wanted * wanted))
                            level = int(HALF * math.log2(texel + F(1e-6)) + F(0.35))
                            tu = u * uvs[i, 0] + v * uvs[j, 0] + w * uvs[k, 0]
                            tv = u * uvs[i, 1] + v * uvs[j, 1] + w * uvs[k, 1]
                            paint = sampled(texels, table, to_linear, picture, level, tu, tv)
                        gloss = (glosses[t, 0], glosses[t, 1])
                        red, green, blue = body_light(
                            u, v, w, t, ray, paint, gloss, points, normals, colours, triangles, to_light, shadow, look
                        )
                    r, g, b = r + toned(red, tone), g + toned(green, tone), b + toned(blue, tone)
            image[row, column, 0] = r * share
            image[row, column, 1] = g * share
            image[row, column, 2] = b * share
