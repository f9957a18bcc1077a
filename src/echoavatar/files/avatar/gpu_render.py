"""Draw the character on a graphics card: the pictures of `render.py` through OpenGL 3.3, without a display (EGL).

The formulas are those of `raster.py` and `shading.py` in GLSL; a test holds the pictures together. Three passes: the
heights seen from the light, the body at `samples` x `samples` a pixel, and the picture: the mean of its samples over
backdrop and floor. Rows of every texture run downwards, as those of the picture do.
"""

import weakref
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from echoavatar.errors import DependencyError

from . import raster, shading
from .character import REDUCTIONS, Texels
from .render import CONTACT_CELLS, SHADOW_TEXELS, Paint, Renderer, Surface

_SRGB8_ALPHA8 = 0x8C43  # of OpenGL: the card makes sRGB linear before it mixes texels
_NEAR_M = 0.05

_LIT = """
uniform mat4x3 to_light;
uniform sampler2D shadow;

float lit(vec3 at, float bias) {  // share of the key light that reaches a point
    vec3 texel = to_light * vec4(at, 1);
    float height = texel.z + bias;
    vec2 place = texel.xy - 0.5;
    ivec2 first = ivec2(place), size = textureSize(shadow, 0);
    if (any(lessThan(first, ivec2(1))) || any(greaterThanEqual(first, size - 2))) return 1.0;
    vec2 part = place - vec2(first);
    float total = 0.0;
    for (int dy = -1; dy < 3; dy++)
        for (int dx = -1; dx < 3; dx++) {
            float wx = dx < 0 ? 1.0 - part.x : dx > 1 ? part.x : 1.0;
            float wy = dy < 0 ? 1.0 - part.y : dy > 1 ? part.y : 1.0;
            if (texelFetch(shadow, first + ivec2(dx, dy), 0).r <= height) total += wx * wy;
        }
    return total / 9.0;
}
"""

_SHADOW_VERTEX = """#version 330
uniform mat4x3 to_light;
uniform float texels;
in vec3 point;
out float height;

void main() {
    vec3 at = to_light * vec4(point, 1);
    height = at.z;
    gl_Position = vec4(at.xy / texels * 2.0 - 1.0, 0, 1);
}
"""

_SHADOW_FRAGMENT = """#version 330
in float height;
out float highest;  // by blending

void main() { highest = height; }
"""

_BODY_VERTEX = """#version 330
uniform mat4 view;
in vec3 point, normal, colour;
in vec2 uv;
out vec3 place, across, tint;
out vec2 at;

void main() {
    place = point; across = normal; tint = colour; at = uv;
    gl_Position = view * vec4(point, 1);
}
"""

_BODY_FRAGMENT = (
    """#version 330
uniform vec3 camera, look[6];
uniform vec2 gloss;
uniform bool is_painted, is_cutout, is_sheer;
uniform float blur, samples;
uniform int levels;
uniform sampler2D picture, tone;
in vec3 place, across, tint;
in vec2 at;
out vec4 seen;
"""
    + _LIT
    + """
vec3 paint() {
    if (!is_painted) return vec3(1);
    vec2 size = vec2(textureSize(picture, 0)), right = dFdx(at) * size, down = dFdy(at) * size;
    float texels = abs(right.x * down.y - right.y * down.x) * samples * samples;  // in a pixel
    float level = clamp(ceil(0.5 * log2(max(texels, 1e-9) / blur)), 0.0, float(levels - 1));
    return textureLod(picture, at, level).rgb;
}

float toned(float value) { return texelFetch(tone, ivec2(clamp(int(value * 1024.0), 0, 4095), 0), 0).r; }

void main() {
    vec3 painted = paint();
    if (is_cutout) {
        ivec2 size = textureSize(picture, 1), odd = ivec2(gl_FragCoord.xy) & 1;
        float least = is_sheer ? (32.0 + 64.0 * float(2 * odd.y + odd.x)) / 255.0 : 0.5;
        if (texelFetch(picture, clamp(ivec2(fract(at) * vec2(size)), ivec2(0), size - 1), 1).a < least) discard;
    }
    vec3 n = normalize(across), ray = normalize(place - camera);
    float light = max(0.0, (dot(n, look[0]) + 0.12) / 1.12);
    if (light > 0.0) light *= lit(place + n * 0.012, 0.008);
    float behind = max(0.0, dot(n, look[4])), up = 0.5 + 0.5 * n.y;
    float facing = max(0.0, 1.0 + dot(n, ray));
    float sheen = facing * facing * facing * 0.18 * up;
    float shine = gloss.x * light;
    if (shine > 2e-3) shine *= pow(max(0.0, dot(n, normalize(look[0] - ray))), gloss.y);
    float near_floor = min(1.0, 0.55 + place.y * 0.9);
    vec3 sum = look[1] * light + look[5] * behind + mix(look[3], look[2], up) * near_floor + sheen;
    sum = sum * painted * tint + shine;
    seen = vec4(toned(sum.r), toned(sum.g), toned(sum.b), 1);
}
"""
)

_WHOLE_VERTEX = """#version 330
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }
"""

_PICTURE_FRAGMENT = (
    """#version 330
uniform sampler2D body, backdrop, contact;
uniform mat3 rays;
uniform vec3 camera;
uniform mat2 contact_map;
uniform vec2 middle, strength;
uniform float fade;
uniform int samples;
uniform bool is_clear;
out vec4 result;
"""
    + _LIT
    + """
float floor_shadow(vec2 pixel) {
    vec3 ray = rays * vec3(1, (pixel + 0.5) * float(samples));
    if (ray.y > -1e-3) return 0.0;
    vec3 at = camera - ray * camera.y / ray.y;
    at.y = 0.0;
    vec2 away = at.xz - middle;
    float fading = 1.0 - dot(away, away) / (fade * fade);
    if (fading <= 0.0) return 0.0;
    float dark = strength.x * (1.0 - lit(at, 0.004)) * fading;
    vec2 cell = vec2(dot(contact_map[0], vec2(at.x, 1)), dot(contact_map[1], vec2(at.z, 1)));
    vec2 cells = vec2(textureSize(contact, 0));
    if (all(greaterThanEqual(cell, vec2(0))) && all(lessThan(cell, cells - 1.0)))
        dark = 1.0 - (1.0 - dark) * (1.0 - strength.y * texture(contact, (cell + 0.5) / cells).r);
    return dark;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 sum = vec4(0);
    for (int y = 0; y < samples; y++)
        for (int x = 0; x < samples; x++) sum += texelFetch(body, pixel * samples + ivec2(x, y), 0);
    sum /= float(samples * samples);
    float dark = floor_shadow(vec2(pixel));
    vec4 behind = is_clear ? vec4(0, 0, 0, dark) : vec4(texelFetch(backdrop, pixel, 0).rgb * (1.0 - dark), 1);
    float alpha = sum.a + (1.0 - sum.a) * behind.a;
    result = vec4((sum.rgb + (1.0 - sum.a) * behind.a * behind.rgb) / max(alpha, 1e-6), alpha);
}
"""
)


class GpuRenderer(Renderer):
    """Draws what `Renderer` draws; any thread may draw, one at a time.

    A context of OpenGL is current in one thread: `draw` takes it and releases it. The context ends with the renderer.
    moderngl holds the interpreter's lock while the card draws.

    Attributes:
        card: the driver's name of the renderer; `llvmpipe` in it means software instead of a card.
    """

    def _allocate(self) -> None:
        """Open a context; where there are several cards, the variable GLCONTEXT_DEVICE_INDEX chooses.

        Raises DependencyError: moderngl is not installed, or there is no OpenGL 3.3 through EGL here.
        """
        self._gl, self._context = _context()
        weakref.finalize(self, self._context.release)
        self._painted: Paint | None = None
        with self._context as context:
            self.card: str = context.info["GL_RENDERER"]
            size, channels = (self.width, self.height), self.empty.shape[2]
            samples = self._grid[::-1]
            self._heights = context.texture((SHADOW_TEXELS, SHADOW_TEXELS), 1, dtype="f4")
            self._body = context.texture(samples, 4)
            self._touched = context.texture((CONTACT_CELLS, CONTACT_CELLS), 1, dtype="f4")
            backdrop = context.texture(size, channels, self.empty.tobytes(), alignment=1)
            tone = context.texture((len(self._tone), 1), 1, self._tone.tobytes())
            self._shadow_target = context.framebuffer([self._heights])
            self._body_target = context.framebuffer([self._body], context.depth_renderbuffer(samples))
            self._target = context.framebuffer([context.renderbuffer(size, 4)])
            self._shadow_program = context.program(vertex_shader=_SHADOW_VERTEX, fragment_shader=_SHADOW_FRAGMENT)
            self._body_program = context.program(vertex_shader=_BODY_VERTEX, fragment_shader=_BODY_FRAGMENT)
            self._program = context.program(vertex_shader=_WHOLE_VERTEX, fragment_shader=_PICTURE_FRAGMENT)
            self._whole = context.vertex_array(self._program, [])
            units = [self._heights, self._body, self._touched, backdrop, tone]
            for unit, texture in enumerate(units):
                texture.use(unit)
            self._unit = len(units)  # of the picture on the body
            _set(self._shadow_program, texels=float(SHADOW_TEXELS))
            _set(self._body_program, shadow=0, tone=4, picture=self._unit, look=self._backdrop.look, levels=REDUCTIONS)
            _set(self._body_program, blur=float(shading.BLUR), samples=float(self.samples))
            _set(self._program, shadow=0, body=1, contact=2, backdrop=3, samples=self.samples)
            _set(self._program, is_clear=channels == 4, strength=self._strength, fade=float(shading.FADE_METRES))

    def draw(self, surface: Surface) -> UInt8[np.ndarray, "h w c"]:
        """The picture in sRGB, and its alpha as a fourth channel if the backdrop is clear."""
        points = np.ascontiguousarray(surface.points, np.float32)
        raster.bounds(points, self._backdrop.look[0], self._bounds)
        middle, contact_map = self._touch(points)
        light = {"to_light": self._light_space(self._backdrop.look[0]).T}
        seen = {"camera": np.array(self.camera.position, np.float32), **light}
        with self._context:
            if self._painted is not surface.paint:
                self._upload(surface.paint)
            self._points.write(points.tobytes())
            self._normals.write(np.ascontiguousarray(surface.normals, np.float32).tobytes())
            self._touched.write(self._contact.tobytes())
            _set(self._shadow_program, **light)
            _set(self._body_program, view=self._view().T, **seen)
            _set(self._program, rays=self._rays(), middle=middle, contact_map=contact_map, **seen)
            self._draw_heights()
            self._draw_body()
            self._target.use()
            self._context.enable_only(self._gl.NOTHING)
            self._whole.render(self._gl.TRIANGLES, vertices=3)
            image = np.empty_like(self.empty)
            self._target.read_into(image, components=image.shape[2], alignment=1)
        return image

    def _draw_heights(self) -> None:
        """The height towards the light of the highest surface over each texel."""
        gl, context = self._gl, self._context
        self._shadow_target.use()
        self._shadow_target.clear(-1e9)
        context.blend_equation, context.front_face = gl.MAX, "ccw"
        for first, count, _, two_sided, *_ in self._parts:
            context.enable_only(gl.BLEND if two_sided else gl.BLEND | gl.CULL_FACE)
            self._caster.render(gl.TRIANGLES, vertices=count, first=first)

    def _draw_body(self) -> None:
        gl, context = self._gl, self._context
        self._body_target.use()
        self._body_target.clear()
        context.front_face = "cw"  # rows run downwards
        for first, count, picture, two_sided, is_cutout, is_sheer, gloss in self._parts:
            context.enable_only(gl.DEPTH_TEST if two_sided else gl.DEPTH_TEST | gl.CULL_FACE)
            _set(self._body_program, gloss=gloss, is_painted=picture >= 0, is_cutout=is_cutout, is_sheer=is_sheer)
            if picture >= 0:
                self._pictures[picture].use(self._unit)
            self._shape.render(gl.TRIANGLES, vertices=count, first=first)

    def _upload(self, paint: Paint) -> None:
        """Send the data that all frames share to the card; triangles of one kind are drawn at once."""
        context, self._painted = self._context, paint
        kinds = np.column_stack([paint.pictures, paint.two_sided, paint.cutouts >= 0, paint.sheer, paint.glosses])
        kinds, kind = np.unique(kinds, axis=0, return_inverse=True)
        counts = 3 * np.bincount(kind)  # corners
        self._parts: list[tuple[Any, ...]] = [
            (int(end - count), int(count), int(picture), *map(bool, flags), (strength, exponent))
            for (picture, *flags, strength, exponent), count, end in zip(
                kinds.tolist(), counts, counts.cumsum(), strict=True
            )
        ]
        triangles = np.ascontiguousarray(paint.triangles[np.argsort(kind, kind="stable")], np.uint32)
        order = context.buffer(triangles.tobytes())
        self._points, self._normals = (context.buffer(reserve=paint.colours.nbytes, dynamic=True) for _ in range(2))
        place = (self._points, "3f", "point")
        painted = [
            (context.buffer(paint.colours.tobytes()), "3f", "colour"),
            (context.buffer(paint.uvs.tobytes()), "2f", "uv"),
        ]
        shape = [place, (self._normals, "3f", "normal"), *painted]
        self._caster = context.vertex_array(self._shadow_program, [place], order)
        self._shape = context.vertex_array(self._body_program, shape, order)
        self._pictures = {int(row): self._picture(paint.texels, row) for row in np.unique(paint.pictures) if row >= 0}

    def _picture(self, texels: Texels, row: int) -> Any:
        """One picture with its reductions."""
        blocks = texels.table[row].tolist()
        levels = [texels.values[start : start + width * height].tobytes() for start, width, height in blocks]
        _, wide, high = blocks[0]
        texture = self._context.texture((wide, high), 4, levels[0], internal_format=_SRGB8_ALPHA8)
        texture.build_mipmaps(0, REDUCTIONS - 1)
        for level, (_, width, height) in enumerate(blocks):
            if (width, height) == (wide >> level, high >> level):  # a picture of a few texels has fewer levels
                texture.write(levels[level], level=level)
        texture.filter = self._gl.LINEAR_MIPMAP_NEAREST, self._gl.LINEAR
        return texture

    def _view(self) -> Float[np.ndarray, "4 4"]:
        """The map from world to the clip space of the samples, y downwards; the far plane is at infinity."""
        high, wide = self._grid
        right, up, back = self.camera.axes
        scaled = np.stack([right * (2 * self._focal / wide), -up * (2 * self._focal / high), -back, -back])
        shift = -scaled @ np.array(self.camera.position)
        shift[2] -= 2 * _NEAR_M
        return np.concatenate([scaled, shift[:, None]], 1).astype(np.float32)


def _context() -> tuple[ModuleType, Any]:
    """The module moderngl, and a context that is current nowhere."""
    try:
        import moderngl
    except ModuleNotFoundError as error:
        raise DependencyError(
            "drawing on a graphics card needs moderngl, which is not installed: pip install 'echoavatar[gpu]'; "
            "or draw with the processor (renderer cpu)"
        ) from error
    try:
        context = moderngl.create_context(require=330, standalone=True, backend="egl")
    except Exception as error:  # glcontext raises nothing finer
        raise DependencyError(
            f"drawing on a graphics card needs OpenGL 3.3 through EGL; opening it failed: {error}. Install the card's "
            "driver with its EGL library (in a container, the capability `graphics`; without a card, Debian's "
            "libegl1 and libgl1-mesa-dri draw in software), or draw with the processor (renderer cpu)"
        ) from error
    with context:
        return moderngl, context


def _set(program: Any, **uniforms: Any) -> None:
    for name, value in uniforms.items():
        if isinstance(value, np.ndarray):
            program[name].write(np.ascontiguousarray(value, np.float32).tobytes())
        else:
            program[name].value = value
