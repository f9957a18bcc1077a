"""The house rules that a linter does not know."""

import importlib.metadata
import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "echoavatar"


@pytest.mark.parametrize("name", ["torchaudio", "torchvision", "torchao", "torchcodec"])
def test_packages_that_break_on_cpu_torch_are_absent(name: str) -> None:
    """They link against libraries that the CPU build lacks; transformers imports them when it finds them."""
    assert importlib.util.find_spec(name) is None


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


def modules() -> list[Path]:
    return sorted(
        path.relative_to(SOURCE)
        for path in SOURCE.rglob("*.py")
        if path.name not in ("__init__.py", "__main__.py")
    )


@pytest.mark.parametrize("module", modules(), ids=str)
def test_every_module_has_a_mirrored_test(module: Path) -> None:
    mirror = ROOT / "tests" / module.parent / f"test_{module.name}"
    assert mirror.exists(), f"src/echoavatar/{module} has no {mirror.relative_to(ROOT)}"


def test_every_room_says_what_it_is_for() -> None:
    for package in SOURCE.rglob("__init__.py"):
        text = package.read_text().lstrip()
        assert text.startswith('"""'), f"{package} has no docstring"
        if package.parent != SOURCE:
            assert "ay import" in text, f"{package} does not say what it may import"


def test_version_is_the_installed_one() -> None:
    from echoavatar import __version__

    assert importlib.metadata.version("echoavatar") == __version__


def test_shipped_weights_stay_small_and_carry_cards() -> None:
    """A clone must stay light (all weights under 60 MB), and every bundle must say what it was trained on."""
    weights = list((SOURCE / "bundles").rglob("*.safetensors"))
    assert weights
    assert sum(path.stat().st_size for path in weights) < 60e6
    for path in weights:
        card = json.loads((path.parent / "card.json").read_text())
        assert {"data", "command", "licence"} <= card.keys(), f"{path.parent.name}: {sorted(card)}"
