"""What each room's docstring says that it may import is true: rooms that exist, and no import beyond them."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HOUSES = {"echoavatar": ROOT / "src", "echoavatar_lab": ROOT / "lab/src"}
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
LAYERS = {
    house: [
        [room.strip(" ()") for room in row.split("|")]
        for row in next(each for each in CONTRACTS if each.get("containers") == [house])["layers"]
    ]
    for house in HOUSES
}
ROOMS = [
    path.parent
    for source in HOUSES.values()
    for path in sorted(source.rglob("__init__.py"))
    if path.parent.parent != source and "egg-info" not in str(path)
]


def dotted(path: Path) -> str:
    """The name of a file or folder as it is imported."""
    source = next(source for source in HOUSES.values() if path.is_relative_to(source))
    return ".".join(path.relative_to(source).with_suffix("").parts).removesuffix(".__init__")


def exists(name: str) -> bool:
    path = HOUSES[name.partition(".")[0]] / name.replace(".", "/")
    return path.is_dir() or path.with_suffix(".py").exists()


def sentence(room: Path) -> str:
    """What the docstring says about imports."""
    text = ast.get_docstring(ast.parse((room / "__init__.py").read_text("utf-8"))) or ""
    found = re.search(r"May import (.+?)[.;](?=\s|$)", text, re.DOTALL)
    return " ".join(found[1].split()) if found else ""


def allowed(room: Path) -> list[str]:
    """The rooms that the sentence names; with "and below", also those under the highest of them."""
    said, own = sentence(room), dotted(room)
    house, names = own.partition(".")[0], re.findall(r"`([\w.]+)`", sentence(room))
    if said.startswith("every room"):
        return ["echoavatar", "echoavatar_lab"]
    found = []
    for name in names:
        parent = own
        while not exists(f"{parent}.{name}") and "." in parent:  # a neighbour, or a room of the house
            parent = parent.rpartition(".")[0]
        named = name if name in HOUSES else f"{parent}.{name}"
        assert exists(named), f"{own} may import {name!r}, which is no room"
        found.append(named)
    if "and below" in said:
        tops = {name.split(".")[1] for name in found if "." in name}
        first = min(at for at, row in enumerate(LAYERS[house]) if tops & set(row))
        found += [f"{house}.{below}" for row in LAYERS[house][first + 1 :] for below in row]
        found += ["echoavatar"] if house == "echoavatar_lab" else []
    return found


def imported(path: Path) -> set[str]:
    """Modules of both houses that a file imports, wherever in the file."""
    own, found = dotted(path), set[str]()
    package = own if path.name == "__init__.py" else own.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            names = {f"{module}.{alias.name}" for alias in node.names}
            found |= {name if name.partition(".")[0] in HOUSES and exists(name) else module for name in names}
    return {name for name in found if name.partition(".")[0] in HOUSES}


@pytest.mark.parametrize("room", ROOMS, ids=dotted)
def test_a_room_imports_what_it_says(room: Path) -> None:
    own = dotted(room)
    assert sentence(room), f"{own} does not say what it may import"
    may = [own, *allowed(room)]
    files = [path for path in room.rglob("*.py") if not any(path.is_relative_to(r) for r in ROOMS if r.parent == room)]
    beyond = {
        f"{dotted(path)} -> {name}"
        for path in files
        for name in imported(path)
        if name != "echoavatar" and not any(name == each or name.startswith(f"{each}.") for each in may)
    }
    assert not beyond, f"{own} may import {sentence(room)!r}"
