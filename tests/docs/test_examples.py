"""The notebook runs from top to bottom, and the Space does what it shows."""

import ast
import importlib.util
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import echoavatar

ROOT = Path(__file__).parents[2]


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a notebook does: the value of a cell's last expression is what it shows."""
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((ROOT / "docs/examples/three_lines.ipynb").read_text("utf-8"))
    names: dict[str, object] = {}
    shown = []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            tree = ast.parse("".join(cell["source"]))
            last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
            exec(compile(tree, "cell", "exec"), names)
            if isinstance(last, ast.Expr):
                shown.append(eval(compile(ast.Expression(last.value), "cell", "eval"), names))
    animation, _, shapes, frames = shown
    assert isinstance(animation, echoavatar.Animation)
    assert animation._repr_html_().startswith("<iframe")
    assert (tmp_path / "speech.glb").stat().st_size > 100_000
    assert shapes["rotations"][1:] == (52, 4)
    assert frames == 28


def test_the_space_moves_an_avatar(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With Gradio where it is installed, else with what the page needs of it."""
    if importlib.util.find_spec("gradio") is None:
        names = ("Audio", "HTML", "File", "Number")
        fake = SimpleNamespace(**dict.fromkeys(names, lambda *_, **__: None), Error=RuntimeError)
        fake.Interface = lambda move, inputs, outputs, **_: (move, inputs, outputs)
        monkeypatch.setitem(sys.modules, "gradio", fake)
    spec = importlib.util.spec_from_file_location("space_app", ROOT / "deploy/space/app.py")
    assert spec is not None
    assert spec.loader is not None
    app = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(app)
    shown, path = app.move(str(ROOT / "src/echoavatar/assets/speech.ogg"), 1)
    assert "srcdoc" in shown
    assert Path(path).read_bytes()[:4] == b"glTF"
    with pytest.raises(app.gr.Error, match="give a sound"):
        app.move(None, 1)
