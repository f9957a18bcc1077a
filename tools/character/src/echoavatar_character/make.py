"""Make the people that ship: `python -m echoavatar_character.make [NAME ...]` writes them into echoavatar/assets."""

import argparse
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

import echoavatar
from echoavatar.files.avatar import MATERIALS, Character, Textures
from echoavatar.files.avatar.character import outfit_picture
from echoavatar.motion.arkit import ARKIT_NAMES

from . import atlas, clothes, eyes, fabric, fit, hair, mouth, occlusion, shoes, skin, tailor
from .bends import bent, eased
from .body import Body, make_body
from .person import PEOPLE, Person
from .stored import LEAST_MOVE, LEAST_TURN, save, sparse
from .surface import Surface, normals, smoothed, triangles

ARMS = [j for j, name in enumerate(fit.NAMES) if name.endswith("UpperArm")]
ATLAS_BYTES, OUTFIT_BYTES = 260_000, 110_000
KNIT_DEPTH, TWILL_DEPTH = 9.0, 5.0  # texels between black and white
INDEX = {material.name: i for i, material in enumerate(MATERIALS)}


def surfaces(body: Body) -> tuple[list[Surface], Surface]:
    """All visible parts, and the whole skin."""
    whole = skin.whole_skin(body)
    cloth = clothes.tights(body)
    seen = skin.seen_skin(whole, body, clothes.neckline(whole.positions, body))
    parts = [seen, *(eyes.eyeball(body, side) for side in ("Left", "Right"))]
    parts += [eyes.lashes(body, side) for side in ("Left", "Right")]
    parts += [mouth.teeth(body, upper=True), mouth.teeth(body, upper=False), mouth.tongue(body)]
    parts += hair.hair(body, whole)
    top, footwear = clothes.top(body, cloth), shoes.shoes(body, cloth)
    legs = clothes.trousers(cloth, footwear)
    if clothes.CUTS[body.person.cut].tucked:
        top = clothes.tucked(top, legs, upwards=False)
    else:
        legs = clothes.tucked(legs, top, upwards=True)
    parts += [top, legs, *footwear]
    if clothes.CUTS[body.person.cut].collar:
        parts.append(clothes.collar(body, top))
    return parts, whole


def make_character(person: Person) -> Character:
    """Build one person."""
    body = make_body(person)
    parts, whole = surfaces(body)
    parts = _shaded(parts, body)
    tints = _tints(person)
    blocks = [_block(part, body, np.array(tints[part.material])) for part in parts]
    return replace(
        _joined(blocks, textures(body, whole, parts)), outfits=tuple(outfit.name for outfit in person.outfits)
    )


def textures(body: Body, whole: Surface, parts: list[Surface]) -> Textures:
    """The pictures, encoded."""
    scalp = hair.scalp_share(body, whole.positions)
    picture = skin.paint(body, whole, scalp)
    for rect, image in (
        (atlas.EYE, eyes.paint_eye(body.person, round((atlas.EYE[2] - atlas.EYE[0]) * atlas.SIZE))),
        (atlas.TEETH, np.ones((8, 8, 3))),
        (atlas.TONGUE, np.ones((8, 8, 3))),
        (atlas.LASH, np.ones((8, 8, 3))),
    ):
        left, top, right, bottom = (round(x * atlas.SIZE) for x in rect)
        margin = 12 if rect is not atlas.EYE else 0
        fitted = _picture(image).resize((right - left + 2 * margin, bottom - top + 2 * margin))
        picture[top - margin : bottom + margin, left - margin : right + margin] = np.asarray(fitted) / 255
    strands = hair.paint_hair(body.person)
    grey = np.clip(strands[..., :3].mean(2) / (np.array(body.person.hair).mean() / 255), 0, 1.8) / 1.8
    pair = np.stack([grey, strands[..., 3]], 2)
    pair = np.round(np.round(pair * 20) / 20 * 255).astype(np.uint8)
    return Textures(
        atlas=_within(_picture(picture), ATLAS_BYTES),
        hair=_encoded(Image.fromarray(pair, "LA"), "PNG", optimize=True),
        **{
            outfit_picture(i): _within(_picture(tailor.picture(body, outfit, parts)), OUTFIT_BYTES)
            for i, outfit in enumerate(body.person.outfits)
        },
        knit_normal=_normals(fabric.knit(), KNIT_DEPTH),
        twill_normal=_normals(fabric.twill(), TWILL_DEPTH),
        skin_normal=_encoded(_picture(skin.relief(body, whole, scalp)), "JPEG", quality=78),
        skin_roughness=_encoded(_picture(skin.roughness(body, whole, scalp)), "JPEG", quality=85),
    )


def _normals(heights: Float[np.ndarray, "h w"], depth: float) -> bytes:
    return _encoded(_picture(fabric.normal_map(heights, depth)), "JPEG", quality=85, subsampling=0)


def _picture(values: Float[np.ndarray, "h w *c"]) -> Image.Image:
    return Image.fromarray(np.round(values * 255).astype(np.uint8))


def _within(image: Image.Image, most: int) -> bytes:
    """A JPEG of the best quality whose file is not too large for the page, in bytes."""
    made = (_encoded(image, "JPEG", quality=quality) for quality in (88, 82, 76, 70, 64, 58))
    return next((each for each in made if len(each) <= most), b"") or _encoded(image, "JPEG", quality=52)


def _encoded(image: Image.Image, kind: str, **options: object) -> bytes:
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def _tints(person: Person) -> dict[str, tuple[float, ...]]:
    """Linear factors by material; pictures that are grey get their colour here."""
    made: dict[str, tuple[float, ...]] = dict.fromkeys(INDEX, (1.0, 1.0, 1.0))
    hair_colour = tuple(1.8**2.2 * _linear(x) for x in person.hair)
    made |= {"hair": hair_colour, "lash": tuple(0.35 * _linear(x) for x in person.hair), "sole": (0.78, 0.77, 0.74)}
    return made


def _linear(value: float) -> float:
    return float((value / 255) ** 2.2)


def _shaded(parts: list[Surface], body: Body) -> list[Surface]:
    """Each part with its ambient occlusion in the colours, and its normals."""
    turned = [normals(part.positions, part.quads) if part.normals is None else part.normals for part in parts]
    starts = np.cumsum([0, *(len(part.positions) for part in parts)])
    points, out = np.concatenate([part.positions for part in parts]), np.concatenate(turned)
    faces = np.concatenate(
        [triangles(part.quads) + start for part, start in zip(parts, starts, strict=False) if part.material != "lash"]
    )
    whole = occlusion.openness(points, out, faces, span=2.1, middle=np.array([0, 0.86, 0]), bias=0.006)
    head = body.joint("head") + [0, 0.06, 0.02]
    close = occlusion.openness(points, out, faces, span=0.5, middle=head, bias=0.0025)
    near = np.clip((points[:, 1] - body.joint("neck")[1] - 0.01) / 0.04, 0, 1)
    light = whole + (close - whole) * near
    made = []
    for part, start, normal in zip(parts, starts, turned, strict=False):
        own = light[start : start + len(part.positions)]
        if part.material == "skin":  # or single ribbons of hair leave spots
            high = np.clip((part.positions[:, 1] - body.eyes["Left"].middle[1] - 0.02) / 0.01, 0, 1)
            own = smoothed(own[:, None], part.quads, 4, 0.5)
            own = smoothed(own, part.quads, 24, 0.5 * high)[:, 0]
        floor = {"eye": 1.0, "lash": 1.0, "mouth": 0.92, "hair": 0.60, "skin": 0.52}.get(part.material, 0.35)
        shade = floor + (1 - floor) * np.clip(own * 1.25, 0, 1)
        tone = np.repeat(shade[:, None], 3, 1)
        if part.material == "skin":  # light that enters skin comes out red
            tone = tone ** np.array([0.75, 1.08, 1.15])
        made.append(replace(part, colours=part.colours * tone, normals=normal))
    return made


def _block(part: Surface, body: Body, tint: Float[np.ndarray, " 3"]) -> dict[str, np.ndarray]:
    """Vertices in the T-pose, one for each place in the texture."""
    weights = bent(eased(part, body) if part.material == "cloth" else part.weights, part.positions, body)
    maps = np.einsum("vj,jik->vik", weights, body.fitted.pose)
    points = fit.to_rest(body.fitted, part.positions, weights)
    if part.material == "cloth":  # where arm and trunk share a vertex, undoing the pose tears; a smooth surface is kept
        shared = part.weights[:, ARMS].sum(1)
        points = smoothed(points, part.quads, 12, 0.5 * np.clip(4 * shared * (1 - shared) - 0.15, 0, 1) ** 0.5)
    assert part.normals is not None
    out = np.einsum("vik,vi->vk", maps[:, :, :3], part.normals)
    names = [name for name in ARKIT_NAMES if name in part.moves]
    moves = np.zeros((len(ARKIT_NAMES), *points.shape))
    turns = np.zeros_like(moves)
    back = np.linalg.inv(maps[:, :, :3])
    flat = normals(part.positions, part.quads)
    for name in names:
        i = ARKIT_NAMES.index(name)
        moves[i] = np.einsum("vik,vk->vi", back, part.moves[name])
        turned = normals(part.positions + part.moves[name], part.quads) - flat
        turned = smoothed(turned, part.quads, 1, 0.5) if part.material == "skin" else turned
        turns[i] = np.einsum("vik,vi->vk", maps[:, :, :3], turned)
        if part.material == "lash":
            turns[i] = 0
    corner = part.quads.ravel()
    keys = np.concatenate([corner[:, None], np.round(part.uvs.reshape(-1, 2) * 8192).astype(int)], 1)
    unique, first, local = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    of = unique[:, 0]
    return {
        "positions": points[of],
        "normals": (out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9))[of],
        "uvs": part.uvs.reshape(-1, 2)[first],
        "colours": np.clip(part.colours * tint, 0, 1)[of],
        "weights": weights[of],
        "materials": np.full(len(of), INDEX[part.material]),
        "moves": moves[:, of],
        "turns": turns[:, of],
        "triangles": triangles(local.reshape(-1, 4)),
    }


def _joined(blocks: list[dict[str, np.ndarray]], pictures: Textures) -> Character:
    """One mesh; vertices that the face moves come first."""
    starts = np.cumsum([0, *(len(block["positions"]) for block in blocks)])
    faces = np.concatenate([block["triangles"] + start for block, start in zip(blocks, starts, strict=False)])
    joined = {
        name: np.concatenate([block[name] for block in blocks])
        for name in ("positions", "normals", "uvs", "colours", "weights", "materials")
    }
    moves, turns = (np.concatenate([block[name] for block in blocks], 1) for name in ("moves", "turns"))
    moved = (np.abs(moves).max((0, 2)) > LEAST_MOVE) | (np.abs(turns).max((0, 2)) > LEAST_TURN)
    order = np.argsort(~moved, kind="stable")
    place = np.empty(len(order), int)
    place[order] = np.arange(len(order))
    table = joined["weights"][order]
    joints = np.argsort(-table, axis=1)[:, :4]
    shares = np.take_along_axis(table, joints, 1)
    return Character(
        positions=joined["positions"][order].astype(np.float32),
        normals=joined["normals"][order].astype(np.float32),
        colours=np.round(joined["colours"][order] ** (1 / 2.2) * 255).astype(np.uint8),
        uvs=joined["uvs"][order].astype(np.float32),
        materials=joined["materials"][order].astype(np.uint8),
        joints=joints.astype(np.uint8),
        weights=shares.astype(np.float32),
        triangles=place[faces].astype(np.int32),
        face=sparse(ARKIT_NAMES, moves[:, order], turns[:, order]),
        textures=pictures,
    )


def main() -> None:
    """Make the named people, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(PEOPLE), help=f"of {', '.join(PEOPLE)}")
    parser.add_argument("--out", type=Path, default=Path(echoavatar.__file__).parent / "assets" / "characters")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for name in args.names:
        made = make_character(PEOPLE[name])
        save(made, args.out / f"{name}.npz")
        size = (args.out / f"{name}.npz").stat().st_size
        print(f"{name}: {len(made.triangles)} triangles, {len(made.positions)} vertices, {size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
