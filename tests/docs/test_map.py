"""The picture and the list of files in docs/architecture.md show the rooms as they are."""

import importlib.util
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_map_and_list_are_made_from_the_present_code() -> None:
    spec = importlib.util.spec_from_file_location("make_map", ROOT / "scripts" / "make_map.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.SHIPPED.read_text() == module.drawing(), "run python scripts/make_map.py"
    assert module.PAGE.read_text("utf-8") == module.page(), "run python scripts/make_map.py"
