"""The house rules that a linter does not know."""

import ast
import importlib.metadata
import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest
from scripts.mutate_constants import constants, mutated

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "echoavatar"
TESTS = {
    SOURCE: ROOT / "tests",
    ROOT / "studio/src/echoavatar_studio": ROOT / "studio/tests",
    ROOT / "lab/src/echoavatar_lab": ROOT / "lab/tests",
    ROOT / "tools/character/src/echoavatar_character": ROOT / "tools/character/tests",
}  # of each package


@pytest.mark.parametrize("name", ["torchaudio", "torchvision", "torchao", "torchcodec"])
def test_packages_that_break_on_cpu_torch_are_absent(name: str) -> None:
    """They link against libraries that the CPU build lacks; transformers imports them when it finds them."""
    assert importlib.util.find_spec(name) is None


def test_progress_bars_are_for_terminals_alone() -> None:
    """In a log every step of a bar is a line."""
    found = 0
    for path in (path for package in [*TESTS, ROOT / "scripts"] for path in package.rglob("*.py")):
        text = path.read_text("utf-8")
        for call in ast.walk(ast.parse(text)) if "tqdm" in text else ():
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "tqdm":
                assert "disable" in {word.arg for word in call.keywords}, f"{path}:{call.lineno}"
                found += 1
    assert found > 10


def test_help_does_not_load_torch() -> None:
    """`echoavatar --help` must answer at once: parsing imports only the command that is asked for."""
    code = """
import sys
from echoavatar.cli import main
try:
    main(["--help"])
except SystemExit:
    print("torch" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("False")


def test_a_live_session_loads_nothing_of_the_lab() -> None:
    """Opens a session, moves it, and lists the modules: none of the lab, the studio or what only they need."""
    code = """
import sys
import numpy as np
import echoavatar.engine
engine = echoavatar.engine.load("default")
with engine.open(seed=1) as session:
    session.push(np.zeros(24_000, np.float32), rate=24_000)
    session.finish()
    assert sum(1 for _ in session) > 2
rooms = {name.partition(".")[0] for name in sys.modules}
print(sorted(rooms & {"echoavatar_lab", "echoavatar_studio", "librosa", "matplotlib", "pretty_midi", "transformers"}))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


def mirrors() -> dict[str, Path]:
    """Every module and the test file that it must have."""
    return {
        path.relative_to(ROOT).as_posix(): tests / path.relative_to(source).parent / f"test_{path.name}"
        for source, tests in TESTS.items()
        for path in sorted(source.rglob("*.py"))
        if path.name not in ("__init__.py", "__main__.py")
    }


@pytest.mark.parametrize(("module", "mirror"), mirrors().items())
def test_every_module_has_a_mirrored_test(module: str, mirror: Path) -> None:
    assert mirror.exists(), f"{module} has no {mirror.relative_to(ROOT)}"


def test_the_table_of_constants_names_what_is_there() -> None:
    """Of `scripts/mutate_constants.py`: each has a value that can be changed, and tests beside it."""
    for constant in constants():
        _, was, became = mutated(constant, down=False)
        assert was != became
        assert all((ROOT / path).exists() for path in constant.tests), constant


def test_every_room_says_what_it_is_for() -> None:
    for source in TESTS:
        for package in source.rglob("__init__.py"):
            text = package.read_text().lstrip()
            assert text.startswith('"""'), f"{package} has no docstring"


def test_version_is_the_installed_one() -> None:
    from echoavatar import __version__

    assert importlib.metadata.version("echoavatar") == __version__


def test_shipped_weights_stay_small_and_carry_cards() -> None:
    """A clone must stay light (the default bundle under 60 MB), and every bundle must say what it was trained on."""
    weights = [path for house in TESTS for path in (house / "bundles").rglob("*.safetensors")]
    assert {"default", "fingers"} <= {part for path in weights for part in path.parts}
    assert sum(path.stat().st_size for path in weights if "default" in path.parts) < 60e6
    for path in weights:
        card = json.loads((path.parent / "card.json").read_text())
        assert {"data", "command", "licence"} <= card.keys(), f"{path.parent.name}: {sorted(card)}"
