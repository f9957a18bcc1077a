"""What the newest dependencies refuse, held here so that the oldest Python's run notices it too."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = [ROOT / name for name in ("src", "studio/src", "lab/src", "tools/character/src")]
JAXTYPES = {"Bool", "Complex", "Float", "Int", "Int8", "Int16", "Int32", "Int64", "Num", "Shaped", "UInt8"}


def test_arrays_in_jaxtyping_are_classes() -> None:
    """`NDArray[...]` is not a class in NumPy 2.5, so jaxtyping refuses it at import; `np.ndarray` is one."""
    found = []
    for path in (path for source in SOURCES for path in source.rglob("*.py")):
        tree = ast.parse(path.read_text())
        aliases = {
            target.id
            for node in tree.body
            if isinstance(node, ast.Assign) and "NDArray[" in ast.unparse(node.value)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Subscript) and ast.unparse(node.value) in JAXTYPES:
                array = ast.unparse(node.slice.elts[0]) if isinstance(node.slice, ast.Tuple) else ""
                if "NDArray[" in array or array == "ArrayLike" or array in aliases:
                    found.append(f"{path.name}:{node.lineno}")
    assert not found, f"jaxtyping over NDArray: {found}"
