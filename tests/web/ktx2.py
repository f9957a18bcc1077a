"""Writes KTX2 pictures of one colour in UASTC (Basis Universal), and puts them into a GLB."""

import struct
from typing import Any

from echoavatar.files.avatar.gltf import container

MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"
Colour = tuple[int, int, int, int]


def make_ktx2(colour: Colour, side: int = 8, *, claimed: int = 0) -> bytes:
    """A square picture; `claimed` is the side that its header states, if another."""
    level = _block(colour) * (-(-side // 4)) ** 2
    descriptor = _descriptor()
    start = (80 + 24 + len(descriptor) + 15) // 16 * 16
    head = struct.pack("<9I", 0, 1, claimed or side, claimed or side, 0, 0, 1, 1, 0)
    index = struct.pack("<4I2Q", 104, len(descriptor), 0, 0, 0, 0)
    entry = struct.pack("<3Q", start, len(level), len(level))
    return (MAGIC + head + index + entry + descriptor).ljust(start, b"\0") + level


def _block(colour: Colour) -> bytes:
    """Sixteen texels in UASTC's mode 8: the mode's five bits, then the colour. What follows helps other formats."""
    bits = 0x17
    for k, value in enumerate(colour):
        bits |= value << (5 + 8 * k)
    return bits.to_bytes(16, "little")


def _descriptor() -> bytes:
    """What KTX2 says of the format: UASTC (166) with the primaries and the curve of sRGB, alpha in the one sample."""
    sample = struct.pack("<HBB4BII", 0, 127, 3, 0, 0, 0, 0, 0, 0xFFFFFFFF)
    block = struct.pack("<IHH4B4B8B", 0, 2, 40, 166, 1, 2, 0, 3, 3, 0, 0, 16, *[0] * 7) + sample
    return struct.pack("<I", 4 + len(block)) + block


def with_ktx2(document: dict[str, Any], binary: bytes, picture: bytes) -> bytes:
    """The GLB with a picture on its first material."""
    data = binary + b"\0" * (-len(binary) % 4)
    views = [*document["bufferViews"], {"buffer": 0, "byteOffset": len(data), "byteLength": len(picture)}]
    data += picture + b"\0" * (-len(picture) % 4)
    surface = {"baseColorTexture": {"index": 0}, "metallicFactor": 0}
    return container(
        document
        | {
            "bufferViews": views,
            "buffers": [{"byteLength": len(data)}],
            "images": [{"mimeType": "image/ktx2", "bufferView": len(views) - 1}],
            "textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}],
            "materials": [{"pbrMetallicRoughness": surface}, *document.get("materials", [])[1:]],
            "extensionsUsed": ["KHR_texture_basisu"],
            "extensionsRequired": ["KHR_texture_basisu"],
        },
        data,
    )
