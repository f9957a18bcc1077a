"""The light on the body, sample by sample at its edges and once a pixel elsewhere, and its shadow on the floor.

Every other pixel keeps the backdrop. Constants are float32, or numba would compute in double precision.
"""

import math

from echoavatar.nn.kernels import kernel

from .raster import HALF, ONE, ZERO, F, repeated

BLUR = F(2.5)  # a sample that covers more texels reads the next smaller picture
FADE_METRES = F(2.6)  # distance from the body at which its shadow on the floor is gone


@kernel(fastmath=True, inline="always")
def lit(x, y, z, to_light, shadow, bias):  # type: ignore[no-untyped-def]
    """Share of the key light that reaches a point: 3 x 3 taps of the shadow map; `to_light` (3, 4) maps to texels.

    Where the corners and the middle of the window agree, they decide alone.
    """
    u = to_light[0, 0] * x + to_light[0, 1] * y + to_light[0, 2] * z + to_light[0, 3]
    v = to_light[1, 0] * x + to_light[1, 1] * y + to_light[1, 2] * z + to_light[1, 3]
    height = to_light[2, 0] * x + to_light[2, 1] * y + to_light[2, 2] * z + to_light[2, 3] + bias
    size = shadow.shape[0]
    column, row = int(u - HALF), int(v - HALF)
    if column < 1 or row < 1 or column >= size - 2 or row >= size - 2:
        return ONE
    corners = 0
    for dy in range(-1, 3, 3):
        for dx in range(-1, 3, 3):
            corners += shadow[row + dy, column + dx] <= height
    corners += shadow[row, column] <= height
    if corners == 5:
        return ONE
    if corners == 0:
        return ZERO
    fu, fv = u - HALF - F(column), v - HALF - F(row)
    total = ZERO  # without branches: at a shadow's edge they would be guessed wrongly
    for dy in range(4):
        weight = ONE - fv if dy == 0 else fv if dy == 3 else ONE
        r = row - 1 + dy
        ends = (ONE - fu) * F(shadow[r, column - 1] <= height) + fu * F(shadow[r, column + 2] <= height)
        total += weight * (ends + F(shadow[r, column] <= height) + F(shadow[r, column + 1] <= height))
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
            texel = start + wrapped(lower + dy - 1, high) * wide + wrapped(right + dx - 1, wide)
            red += share * to_linear[texels[texel, 0]]
            green += share * to_linear[texels[texel, 1]]
            blue += share * to_linear[texels[texel, 2]]
    return red, green, blue


@kernel(fastmath=True, inline="always")
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
    behind = max(ZERO, nx * look[4, 0] + ny * look[4, 1] + nz * look[4, 2])
    up = HALF + HALF * ny
    facing = max(ZERO, ONE + nx * dx + ny * dy + nz * dz)
    sheen = facing * facing * facing * F(0.18) * up
    hx, hy, hz = lx - dx, ly - dy, lz - dz
    h = ONE / math.sqrt(hx * hx + hy * hy + hz * hz + F(1e-12))
    shine = gloss[0] * light
    if shine > F(2e-3):
        shine *= max(ZERO, (nx * hx + ny * hy + nz * hz) * h) ** gloss[1]
    near_floor = min(ONE, F(0.55) + y * F(0.9))
    red = look[1, 0] * light + look[5, 0] * behind + (look[3, 0] + (look[2, 0] - look[3, 0]) * up) * near_floor
    green = look[1, 1] * light + look[5, 1] * behind + (look[3, 1] + (look[2, 1] - look[3, 1]) * up) * near_floor
    blue = look[1, 2] * light + look[5, 2] * behind + (look[3, 2] + (look[2, 2] - look[3, 2]) * up) * near_floor
    red = (red + sheen) * paint[0] * (u * colours[a, 0] + v * colours[b, 0] + w * colours[c, 0])
    green = (green + sheen) * paint[1] * (u * colours[a, 1] + v * colours[b, 1] + w * colours[c, 1])
    blue = (blue + sheen) * paint[2] * (u * colours[a, 2] + v * colours[b, 2] + w * colours[c, 2])
    return red + shine, green + shine, blue + shine


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


@kernel(fastmath=True)
def floor_shadow(image, box, samples, camera, rays, middle, to_light, shadow, contact, contact_map, strength):  # type: ignore[no-untyped-def]
    """Darken the floor in `box` by the key light's shadow and by the nearness of the body (`contact`, n x n).

    `contact_map` (2, 2) holds scale and shift from metres (x, z) to cells. A fourth channel becomes opaque instead.
    """
    left, top, right, bottom = box
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
        for column in range(left, right):
            x, z = x0 + F(column - left) * across, z0 + F(column - left) * away
            fading = ONE - ((x - middle[0]) ** 2 + (z - middle[1]) ** 2) * (ONE / FADE_METRES**2)
            if fading <= ZERO:
                continue
            dark = strength[0] * (ONE - lit(x, ZERO, z, to_light, shadow, F(0.004))) * fading
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
    screen, points, normals, colours, triangles, ids, depth, box, samples, camera, rays, to_light, shadow, look, tone,
    image, uvs, pictures, glosses, sheer, texels, table, to_linear,
):  # fmt: skip
    """Draw the body on `image` (h, w, 3 or 4) uint8 from `samples` x `samples` visibility samples a pixel, in `box`.

    `pictures` (f) and `glosses` (f, 2) are the picture (or -1) and the highlights of each triangle.
    `look` rows: light direction, key light, sky, ground, direction and colour of the light from behind. Samples that
    see the same stretch of surface are lit once, unless it is `sheer` (f).
    """
    left, top, right, bottom = box
    has_alpha = image.shape[2] == 4
    for row in range(top // samples, (bottom + samples - 1) // samples):
        for column in range(left // samples, (right + samples - 1) // samples):
            seen, is_mixed = 0, False
            nearest, farthest = ZERO, F(1e9)
            for sy in range(samples):
                for sx in range(samples):
                    near = depth[row * samples + sy, column * samples + sx]
                    if near > ZERO:
                        seen += 1
                        is_mixed |= sheer[ids[row * samples + sy, column * samples + sx]]
                    nearest, farthest = max(nearest, near), min(farthest, near)
            if seen == 0:
                continue
            r, g, b = ZERO, ZERO, ZERO
            wanted = samples if is_mixed or nearest - farthest >= F(0.004) * nearest else 1
            for sy in range(wanted):
                for sx in range(wanted):
                    y, x = row * samples + sy, column * samples + sx
                    t = ids[y, x]
                    if t < 0:
                        continue
                    px, py = F(x) + HALF, F(y) + HALF
                    ray = ray_through(rays, px, py)
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
                        level = 0
                        while texel > BLUR and level < table.shape[1] - 1:
                            level, texel = level + 1, texel * F(0.25)
                        tu = u * uvs[i, 0] + v * uvs[j, 0] + w * uvs[k, 0]
                        tv = u * uvs[i, 1] + v * uvs[j, 1] + w * uvs[k, 1]
                        paint = sampled(texels, table, to_linear, picture, level, tu, tv)
                    gloss = (glosses[t, 0], glosses[t, 1])
                    red, green, blue = body_light(
                        u, v, w, t, ray, paint, gloss, points, normals, colours, triangles, to_light, shadow, look
                    )
                    r, g, b = r + toned(red, tone), g + toned(green, tone), b + toned(blue, tone)
            share = F(wanted * wanted)
            empty = share - F(seen if wanted > 1 else 1)
            under = F(image[row, column, 3]) / F(255.0) if has_alpha else ONE
            weight = share - empty + empty * under  # of all that is not clear
            image[row, column, 0] = (r + empty * under * F(image[row, column, 0])) / weight + HALF
            image[row, column, 1] = (g + empty * under * F(image[row, column, 1])) / weight + HALF
            image[row, column, 2] = (b + empty * under * F(image[row, column, 2])) / weight + HALF
            if has_alpha:
                image[row, column, 3] = F(255.0) * weight / share + HALF
