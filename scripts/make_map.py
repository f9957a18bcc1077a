"""Draw the picture that opens docs/architecture.md: both houses' rooms in the order of the import contracts, and the
way of one chunk.

    python scripts/make_map.py          # writes docs/img/map.svg, and the list of files in docs/architecture.md

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
LAB = ROOT / "lab" / "src" / "echoavatar_lab"
SHIPPED = ROOT / "docs" / "img" / "map.svg"
PAGE = ROOT / "docs" / "architecture.md"
FILES = "## Other files\n", "\n## One chunk\n"  # the list stands between these headings
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


def layers(house: str) -> list[list[str]]:
    """Rows of a package's rooms, highest first."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    contract = next(each for each in contracts if each.get("containers") == [house])
    return [[room.strip(" ()") for room in row.split("|")] for row in contract["layers"]]


def purpose(source: Path, room: str) -> str:
    """The first sentence of a room's docstring."""
    path = source / room / "__init__.py"
    path = path if path.exists() else source / f"{room}.py"
    text = ast.get_docstring(ast.parse(path.read_text())) or ""
    return " ".join(text.split("\n\n")[0].split()).split(". ")[0].rstrip(".")


def inside(folder: Path) -> str:
    """The packages inside a room."""
    return ", ".join(sorted(path.parent.name for path in folder.glob("*/__init__.py"))) if folder.is_dir() else ""


def box(x: float, y: float, width: float, height: float, fill: str) -> str:
    """A rounded rectangle."""
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" fill="{fill}" stroke="#8896a8"/>'


def words(x: float, y: float, text: str, *, size: int = 12, bold: bool = False, fill: str = "#1c2430") -> str:
    """A line of text."""
    weight = ' font-weight="600"' if bold else ""
    return f'<text x="{x}" y="{y}" font-size="{size}"{weight} fill="{fill}" {FONT}>{escape(text)}</text>'


def rooms(source: Path, top: int, fill: str) -> list[str]:
    """A house: a row of boxes for each layer, from `top` downwards."""
    out = []
    for index, row in enumerate(layers(source.name)):
        y, width = top + ROW * index, (RIGHT - LEFT - 60) / len(row)
        for place, room in enumerate(row):
            x = LEFT + place * width
            out.append(box(x, y, width - 8, ROW - 8, fill if (source / room).is_dir() else "#f6f4ec"))
            out.append(words(x + 10, y + 18, room, size=14, bold=True))
            if len(row) == 1 and (packages := inside(source / room)):
                out.append(words(x + 10 + 9 * len(room) + 12, y + 18, packages, fill="#4a5a70"))
            shown = textwrap.shorten(purpose(source, room), round((width - 30) / 5.8), placeholder=" ...")
            out.append(words(x + 10, y + 34, shown, size=11, fill="#4a5a70"))
    return out


def drawing() -> str:
    """The whole picture."""
    below = 50 + ROW * len(layers(LAB.name))
    height = below + 50 + ROW * len(layers(SOURCE.name)) + 20
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}">',
        '<defs><marker id="tip" markerWidth="8" markerHeight="8" refX="4" refY="4" orient="auto">'
        '<path d="M1 1 L7 4 L1 7 z" fill="#4a5a70"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
        words(LEFT, 32, "The lab makes what runs (echoavatar_lab)", size=16, bold=True),
        *rooms(LAB, 50, "#f3eaf6"),
        words(LEFT, below + 32, "The avatar runs (echoavatar); it knows nothing of the lab", size=16, bold=True),
        *rooms(SOURCE, below + 50, "#e8eef6"),
        words(RIGHT, 32, "One chunk (267 ms)", size=16, bold=True),
    ]
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


def listing(told: str) -> str:
    """The files of both houses that the page has not `told`, by room: names only, which are chosen to tell."""
    lines = []
    for source in (SOURCE, LAB):
        lines += ["", f"`{source.relative_to(ROOT)}`", ""]
        for room in [source, *sorted(path.parent for path in source.rglob("__init__.py") if path.parent != source)]:
            paths = [path for path in sorted(room.glob("*.py")) if not path.stem.startswith("__")]
            names = ", ".join(path.stem for path in paths if not _is_told(path, room.relative_to(source), told))
            if names:
                where = f"`{room.relative_to(source)}/`" if room != source else "top"
                lines += textwrap.wrap(f"- {where}: {names}", 120, subsequent_indent="  ", break_on_hyphens=False)
    return "\n".join(lines) + "\n"


def _is_told(path: Path, room: Path, told: str) -> bool:
    """Whether a row names the file, with its room or beside another of its room."""
    rows = [
        row for row in told.splitlines() if row.startswith("|") and (f"/{path.name}`" in row or f"`{path.name}`" in row)
    ]
    return any(f"{room.as_posix()}/" in row or room == Path() for row in rows)


def page() -> str:
    """docs/architecture.md with the present list of files."""
    text = PAGE.read_text("utf-8")
    before, rest = text.split(FILES[0])
    return before + FILES[0] + listing(before) + FILES[1] + rest.split(FILES[1])[1]


if __name__ == "__main__":
    SHIPPED.write_text(drawing())
    PAGE.write_text(page(), "utf-8")
    print(f"wrote {SHIPPED.relative_to(ROOT)}")
