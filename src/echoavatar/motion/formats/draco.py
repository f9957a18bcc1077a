"""Draco meshes of a glTF file (`KHR_draco_mesh_compression`), decoded in a process of their own.

Nothing in a Draco mesh tells how much it unpacks to: 38 kB may be 800 MB. So this file is also a program, whose memory
and seconds are bounded, and which imports nothing else of the package.
"""

import json
import re
import struct
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

MEMORY = 224 << 20  # bytes that decoding may take
SECONDS = 60
INDICES = -1  # stands for the id of the triangles' corners
Array = np.ndarray


def unpacked(parts: Sequence[tuple[bytes, dict[str, int]]], most: int) -> list[dict[str, Array]]:
    """The wanted attributes (v, n) of each mesh, of `most` bytes in all.

    `parts` are the bytes of each mesh, and the ids of the attributes by name.

    Raises:
        ModuleNotFoundError: DracoPy is missing.
        ValueError: a mesh is damaged or too large, or has no such attribute.
    """
    import DracoPy  # noqa: F401  # so that this process raises if it is missing

    order = json.dumps([[len(data), wanted] for data, wanted in parts]).encode()
    sent = struct.pack("<II", len(order), most) + order + b"".join(data for data, _ in parts)
    program = [sys.executable, "-P", __file__]
    try:
        done = subprocess.run(program, input=sent, capture_output=True, timeout=SECONDS, check=True)
    except (subprocess.SubprocessError, OSError) as error:
        raise ValueError(f"a Draco mesh that is damaged, or takes more than {MEMORY >> 20} MB") from error
    found, at = list[dict[str, Array]](), 0
    for _, wanted in parts:
        found.append({})
        for name in wanted:  # kind, rows, columns, and the numbers
            kind, rows, columns = struct.unpack_from("<2sII", done.stdout, at)
            numbers = np.frombuffer(done.stdout, kind.decode(), rows * columns, at + 10)
            found[-1][name] = numbers.reshape(rows, columns)
            at += 10 + numbers.nbytes
    return found


def _serve() -> None:
    """Decode the meshes that `unpacked` sends to standard input, and write their arrays to standard output."""
    import DracoPy

    with suppress(ImportError, OSError, ValueError):  # some systems have no such limit
        import resource

        status = Path("/proc/self/status")
        held = re.search(r"VmData:\s*(\d+)", status.read_text(encoding="utf-8")) if status.exists() else None
        most = MEMORY + (int(held[1]) << 10 if held else MEMORY)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    source, target = sys.stdin.buffer, sys.stdout.buffer
    length, left = struct.unpack("<II", source.read(8))
    for size, wanted in json.loads(source.read(length)):
        mesh: Any = DracoPy.decode(source.read(size))
        for unique in wanted.values():
            values = mesh.faces if unique == INDICES else mesh.get_attribute_by_unique_id(unique)["data"]
            left -= values.nbytes
            if left < 0:
                raise MemoryError
            target.write(struct.pack("<2sII", values.dtype.str[1:].encode(), *values.shape))
            target.write(np.ascontiguousarray(values).tobytes())


if __name__ == "__main__":
    _serve()
