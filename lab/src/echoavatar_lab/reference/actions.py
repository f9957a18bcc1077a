"""The release's table of actions, read as data from the script that contains it. The script never runs.

A Python file is parsed, and the largest dictionary of texts to lists of whole numbers is the table. A JSON file of the
same form works too. A negative code stands for a code of the lower body's first layer, which the script writes as
code - 6 x 512.
"""

import ast
import operator
from collections.abc import Mapping, Sequence
from pathlib import Path

from echoavatar.engine.pipeline import Action, ActionLibrary
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.json_reader import read_json
from echoavatar.limits import CONFIG_BYTES, read_bytes
from echoavatar.timing import CHUNK, ChunkSize

LOWER_SHIFT = 6 * 512
HOLD_S = 4.0  # how long an action holds unless the caller says; in the release it holds until the next one
_ABOUT = "published with the authors' model; a set of codes that holds as a whole"
_OPERATORS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul}

Table = dict[str, list[int]]


def find_table(stats: Path) -> Path | None:
    """The script that contains the table: in the folder `scripts` beside the stats folder, or None."""
    scripts = sorted((stats.resolve().parent / "scripts").glob("*.py"), reverse=True)
    return next((path for path in scripts if _holds_table(path)), None)


def _holds_table(path: Path) -> bool:
    try:
        return bool(_tables(read_bytes(path, CONFIG_BYTES).decode(errors="replace")))
    except (OSError, EchoAvatarError):
        return False


def read_table(path: Path) -> Table:
    """The table in a Python or JSON file. Raises CheckpointError if the file is missing or contains no table."""
    try:
        text = read_bytes(path, CONFIG_BYTES, CheckpointError).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise CheckpointError(f"the table of actions {path} cannot be read; check the name") from error
    found = _tables(text) if path.suffix == ".py" else _json_tables(text)
    if not found:
        raise CheckpointError(f"{path} has no table of actions (names with lists of codes); give the authors' script")
    return max(found, key=len)


def library(table: Mapping[str, Sequence[int]], codes: int, *, origin: str, chunk: ChunkSize = CHUNK) -> ActionLibrary:
    """The table as a library of actions. `codes` is the size of one codebook: upper body first, then the lower.

    Raises CheckpointError if a code lies outside the codebooks.
    """
    actions = {}
    for name, own in table.items():
        places = [code if code >= 0 else codes + code + LOWER_SHIFT for code in own]
        if not places or not all(0 <= place < 2 * codes for place in places):
            raise CheckpointError(
                f"{origin}: the action {name!r} names codes beyond {codes} ({str(own)[:80]});"
                " give the table of these weights"
            )
        key = "_".join(name.lower().replace("-", " ").replace("_", " ").split())
        own_codes, hold = tuple(sorted(set(places))), (0, chunk.within(HOLD_S))
        actions[key] = Action(key, own_codes, hold, _ABOUT, is_set=True, chunk=chunk)
    return ActionLibrary(actions)


def _tables(text: str) -> list[Table]:
    try:
        tree = ast.parse(text)
        found = [_table(node) for node in ast.walk(tree) if isinstance(node, ast.Dict)]
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []
    return [table for table in found if table]


def _table(node: ast.Dict) -> Table | None:
    table: Table = {}
    for key, value in zip(node.keys, node.values, strict=True):
        if not (isinstance(key, ast.Constant) and isinstance(key.value, str)):
            return None
        if not isinstance(value, ast.List | ast.Tuple | ast.Set):
            return None
        numbers = [_number(part) for part in value.elts]
        if not numbers or any(number is None for number in numbers):
            return None
        table[key.value] = [number for number in numbers if number is not None]
    return table or None


def _number(node: ast.expr) -> int | None:
    if isinstance(node, ast.Constant) and type(node.value) is int:
        return node.value
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        inner = _number(node.operand)
        return None if inner is None else -inner
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        left, right = _number(node.left), _number(node.right)
        return None if left is None or right is None else int(_OPERATORS[type(node.op)](left, right))
    return None


def _json_tables(text: str) -> list[Table]:
    try:
        stored = read_json(text, "the table")
    except EchoAvatarError:
        return []
    is_table = isinstance(stored, dict) and all(
        isinstance(value, list) and value and all(type(code) is int for code in value) for value in stored.values()
    )
    return [stored] if is_table and stored else []
