"""Draw the picture that opens docs/architecture.md: the rooms in the order of the import contract, and one chunk's way.

    python scripts/make_map.py          # writes docs/img/map.svg

Rooms and their order come from pyproject.toml, their purpose from their docstrings. tests/docs/test_map.py fails when
the picture is out of date.
"""

import ast
import textwrap
import tomllib
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "echoavatar"
SHIPPED = ROOT / "docs" / "img" / "map.svg"
CHUNK = [
    ("sound", "any rate, any cutting: speech, music, silence"),
    ("engine.AudioQueue", "24 kHz, 6,400 samples to a chunk, bounded"),
    ("models.audio", "20 frames x 2 codes"),
    ("models.generator", "2 x 3 x Q motion codes, drawn one by one"),
    ("models.tokenizer", "8 frames x 315 features"),
    ("motion.stages", "smoother, ground, leash, feet, hands"),
    ("models.face", "52 ARKit curves from the same sound"),
    ("engine.Session", "actions, gaze, idle motion, barge-in"),
    ("server / files", "motion, face and sound on one clock"),
]
WIDTH, ROW, LEFT, RIGHT = 1180, 50, 20, 800
FONT = 'font-family="system-ui, sans-serif"'


def layers() -> list[list[str]]:
    """Rows of rooms, highest first."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    return [[room.strip(" ()") for room in row.split("|")] for row in contracts[0]["layers"]]


def purpose(room: str) -> str:
    """The first sentence of a room's docstring."""
    path = SOURCE / room / "__init__.py"
    path = path if path.exists() else SOURCE / f"{room}.py"
    text = ast.get_docstring(ast.parse(path.read_text())) or ""
    return " ".join(text.split("\n\n")[0].split()).split(". ")[0].rstrip(".")


def inside(room: str) -> str:
    """The packages inside a room."""
    folder = SOURCE / room
    return ", ".join(sorted(path.parent.name for path in folder.glob("*/__init__.py"))) if folder.is_dir() else ""


def box(x: float, y: float, width: float, height: float, fill: str) -> str:
    """A rounded rectangle."""
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" fill="{fill}" stroke="#8896a8"/>'


def words(x: float, y: float, text: str, *, size: int = 12, bold: bool = False, fill: str = "#1c2430") -> str:
    """A line of text."""
    weight = ' font-weight="600"' if bold else ""
    return f'<text x="{x}" y="{y}" font-size="{size}"{weight} fill="{fill}" {FONT}>{escape(text)}</text>'


def drawing() -> str:
    """The whole picture."""
    rows = layers()
    height = 70 + ROW * len(rows) + 20
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}">',
        '<defs><marker id="tip" markerWidth="8" markerHeight="8" refX="4" refY="4" orient="auto">'
        '<path d="M1 1 L7 4 L1 7 z" fill="#4a5a70"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
        words(LEFT, 32, "Rooms: each uses rooms below it only", size=16, bold=True),
        words(RIGHT, 32, "One chunk (267 ms)", size=16, bold=True),
    ]
    for index, row in enumerate(rows):
        y, width = 50 + ROW * index, (RIGHT - LEFT - 60) / len(row)
        for place, room in enumerate(row):
            x = LEFT + place * width
            out.append(box(x, y, width - 8, ROW - 8, "#e8eef6" if (SOURCE / room).is_dir() else "#f6f4ec"))
            out.append(words(x + 10, y + 18, room, size=14, bold=True))
            if len(row) == 1 and (packages := inside(room)):
                out.append(words(x + 10 + 9 * len(room) + 12, y + 18, packages, fill="#4a5a70"))
            shown = textwrap.shorten(purpose(room), round((width - 30) / 5.8), placeholder=" ...")
            out.append(words(x + 10, y + 34, shown, size=11, fill="#4a5a70"))
    step = (height - 90) / len(CHUNK)
    for index, (name, what) in enumerate(CHUNK):
        top = 50 + step * index
        out.append(box(RIGHT, top, WIDTH - RIGHT - 20, step - 26, "#eaf4ea"))
        out.append(words(RIGHT + 10, top + 22, name, size=14, bold=True))
        out.append(words(RIGHT + 10, top + 40, what, size=11, fill="#4a5a70"))
        if index + 1 < len(CHUNK):
            middle = (RIGHT + WIDTH - 20) / 2
            out.append(
                f'<line x1="{middle}" y1="{top + step - 26}" x2="{middle}" y2="{top + step - 5}" '
                'stroke="#4a5a70" stroke-width="1.5" marker-end="url(#tip)"/>'
            )
    return "\n".join([*out, "</svg>", ""])


if __name__ == "__main__":
    SHIPPED.write_text(drawing())
    print(f"wrote {SHIPPED.relative_to(ROOT)}")
