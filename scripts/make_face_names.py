"""Write what the pages know of other characters' faces, and names with what they say, which the client's tests read.

python -m scripts.make_face_names  # after a change of motion/words.toml or motion/face_names.py; then `make web`
"""

import json
from pathlib import Path

import numpy as np
from tests.motion.foreign_faces import FACES

from echoavatar.motion import face_names
from echoavatar.motion.arkit import APPLE_NAMES, ARKIT_NAMES
from echoavatar.motion.face_names import driven, face_weights, read_name, silent_curves

ROOT = Path(__file__).parents[1]
TARGET = ROOT / "web" / "packages" / "client" / "src" / "facenames.generated.ts"
CASES = ROOT / "tests" / "web" / "face_names.json"
HEAD = "/** The names of other faces. Do not edit: scripts/make_face_names.py makes it of motion/face_names.py. */\n"


def text() -> str:
    """The tables for the pages."""
    tables = {
        "ARKIT_NAMES": ARKIT_NAMES,
        "APPLE_NAMES": APPLE_NAMES,
        "SPELT": dict(sorted(face_names._SPELT.items())),
        "PHRASES": {" ".join(sorted(bag)): list(found) for bag, found in face_names._PHRASES.items()},
        **{
            name: getattr(face_names, name)
            for name in ("VOWELS", "SUMS", "MIXED", "SPOKEN", "NEAREST", "PARTS", "ENDINGS")
        },
    }
    kinds = {"PHRASES": "Record<string, [shape: string, isOurs: boolean]>", "SPELT": "Record<string, string>"}
    kinds |= dict.fromkeys(("SUMS", "MIXED"), "Record<string, Record<string, number>>")
    lines = [HEAD]
    for name, table in tables.items():
        kind = kinds.get(name, "Record<string, string>" if isinstance(table, dict) else "readonly string[]")
        if isinstance(table, dict):
            rows = "".join(
                f"  {json.dumps(k, ensure_ascii=False)}: {json.dumps(v)},\n" for k, v in sorted(table.items())
            )
            lines.append(f"\nexport const {name}: {kind} = {{\n{rows}}};\n")
        else:
            lines.append(f"\nexport const {name}: {kind} = {json.dumps(table)};\n")
    return "".join(lines)


def cases() -> str:
    """Names, faces, and what is made of them."""
    draw = np.random.default_rng(5)
    curves = (draw.uniform(0, 0.7, (8, 52)) * (draw.uniform(0, 1, (8, 52)) < 0.6)).astype(np.float32).round(3)
    faces = {
        kind: {
            "names": names,
            "weights": np.round(face_weights(driven(names), curves).astype(float), 4).tolist(),
            "silent": silent_curves(driven(names)),
        }
        for kind, names in FACES.items()
    }
    names = [name for names in FACES.values() for name in names]
    read = {name: None if (found := read_name(name)) is None else [*found] for name in names}
    return json.dumps({"curves": curves.tolist(), "read": read, "faces": faces}, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    TARGET.write_text(text(), "utf-8")
    CASES.write_text(cases(), "utf-8")
