"""An edit of a kernel takes effect, whichever file it is in."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from echoavatar.nn import kernels
from echoavatar.nn.kernels import compilations, fingerprint, kernel

SCALE = 2.0


@kernel()
def scaled(x):  # type: ignore[no-untyped-def]
    return SCALE * x


def calls_scaled(x):  # type: ignore[no-untyped-def]
    return scaled(x) + 1.0


def test_a_kernel_computes_what_its_function_computes() -> None:
    assert kernel()(calls_scaled)(3.0) == 7.0


def _sabotaged(folder: Path, edits: dict[str, tuple[str, str]]) -> float:
    """What the outer kernel of a small package answers in a process of its own, after edits of its files."""
    for name, (old, new) in edits.items():
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))
    code = f"import sys; sys.path.insert(0, {str(folder)!r}); import outer; print(outer.outer(2.0))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)


def test_an_edit_of_an_inner_kernel_in_another_file_takes_effect(tmp_path: Path) -> None:
    """Numba alone keeps answering 12: it looks at the file of the outer function only."""
    head = "from echoavatar.nn.kernels import kernel\n"
    (tmp_path / "constants.py").write_text("FACTOR = 3.0\n")
    (tmp_path / "inner.py").write_text(
        head + "from constants import FACTOR\n@kernel()\ndef inner(x):\n    return FACTOR * x\n"
    )
    (tmp_path / "outer.py").write_text(
        head + "from inner import inner\n@kernel()\ndef outer(x):\n    return 2.0 * inner(x)\n"
    )
    assert _sabotaged(tmp_path, {}) == 12.0
    assert _sabotaged(tmp_path, {"inner.py": ("FACTOR * x", "FACTOR * x + 1.0")}) == 14.0
    assert _sabotaged(tmp_path, {"constants.py": ("3.0", "5.0")}) == 22.0


def test_a_name_that_is_not_there_yet_is_refused() -> None:
    def early(x):  # type: ignore[no-untyped-def]
        return later(x)  # type: ignore[name-defined]  # noqa: F821

    with pytest.raises(NameError, match="later, which must be defined before"):
        fingerprint(early)


def test_an_array_is_told_by_its_content() -> None:
    def shifted(x):  # type: ignore[no-untyped-def]
        return x + TABLE[0]

    global TABLE
    TABLE = np.zeros(2000)
    before = fingerprint(shifted)
    TABLE[1000] = 1.0
    assert fingerprint(shifted) != before


def test_every_process_finds_what_another_compiled(tmp_path: Path) -> None:
    """Sets of strings print in another order under another hash seed; a folder named after that is found by luck."""
    code = "from echoavatar.nn.kernels import kernel\n@kernel(reorders=True)\ndef one(x):\n    return x + 1.0\n"
    (tmp_path / "once.py").write_text(code + "print(one.fingerprint)\n")
    found = {
        subprocess.run(
            [sys.executable, "once.py"],
            capture_output=True,
            text=True,
            check=True,
            cwd=tmp_path,
            env=os.environ | {"PYTHONHASHSEED": seed},
        ).stdout
        for seed in "123"
    }
    assert len(found) == 1


def test_only_what_the_cache_lacks_counts_as_compiled(tmp_path: Path) -> None:
    (tmp_path / "count.py").write_text(
        "from echoavatar.nn.kernels import compilations, kernel\n"
        "@kernel()\ndef one(x):\n    return x + 1.0\n"
        "said = []\nwith compilations(lambda: said.append('compiling')) as names:\n    one(1.0)\n    one(2.0)\n"
        "print(names, said)\n"
    )
    runs = [
        subprocess.run([sys.executable, "count.py"], capture_output=True, text=True, check=True, cwd=tmp_path).stdout
        for _ in range(2)
    ]
    assert runs == ["['one'] ['compiling']\n", "[] []\n"]


def test_reading_what_was_compiled_imports_no_linear_algebra(tmp_path: Path) -> None:
    """It loads SciPy; a sum of numba's own lies in the module that imports it."""
    (tmp_path / "total.py").write_text(
        "import sys\nimport numpy as np\nfrom echoavatar.nn.kernels import compilations, kernel\n"
        "@kernel()\ndef total(x):\n    return x.sum()\n"
        "with compilations() as names:\n    value = total(np.ones(3))\n"
        "print(value, names, 'numba.np.arraymath' in sys.modules)\n"
    )
    runs = [
        subprocess.run([sys.executable, "total.py"], capture_output=True, text=True, check=True, cwd=tmp_path).stdout
        for _ in range(2)
    ]
    assert "True" in runs[0]
    assert runs[1] == "3.0 [] False\n"


def test_an_argument_whose_class_moved_to_another_module_is_compiled_for_anew(tmp_path: Path) -> None:
    """Numba alone ends in ModuleNotFoundError: its cache names the old module."""
    pair = "from typing import NamedTuple\nclass Pair(NamedTuple):\n    a: float\n    b: float\n"
    (tmp_path / "total.py").write_text(
        "from echoavatar.nn.kernels import kernel\n@kernel()\ndef total(pair):\n    return pair.a + pair.b\n"
    )
    for module in ("old", "new"):
        (tmp_path / f"{module}.py").write_text(pair)
        code = f"from {module} import Pair\nfrom total import total\nprint(total(Pair(1.0, 2.0)))"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
        assert done.stdout == "3.0\n"
        (tmp_path / f"{module}.py").unlink()


def doubled(x):  # type: ignore[no-untyped-def]
    return 2.0 * x


NOWHERE = Path(os.devnull) / "cache"


def made(folders: list[Path], written: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What a new process compiles that reads these folders and writes another."""
    monkeypatch.setattr(kernels, "_folders", lambda: folders)
    monkeypatch.setattr(kernels, "cache_folder", lambda: written)
    one = kernel()(doubled)
    with compilations() as names:
        assert one(2.0) == 4.0
    return names


def test_a_kernel_needs_no_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    assert made([NOWHERE], NOWHERE, monkeypatch) == ["doubled"]
    assert made([], NOWHERE, monkeypatch) == ["doubled"]


def test_kernels_that_came_with_an_image_are_read_where_nothing_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    shipped, own = tmp_path / "shipped", tmp_path / "own"
    assert made([shipped], shipped, monkeypatch) == ["doubled"]
    before = {path: path.read_bytes() for path in shipped.rglob("*") if path.is_file()}
    assert made([NOWHERE, own, shipped], NOWHERE, monkeypatch) == []
    assert {path: path.read_bytes() for path in shipped.rglob("*") if path.is_file()} == before
    assert not own.exists()
    assert not caplog.records


@pytest.mark.parametrize("damage", [b"", b"no index", b"\x80\x04\x95"])
def test_a_damaged_cache_is_compiled_anew(damage: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert made([tmp_path], tmp_path, monkeypatch) == ["doubled"]
    for pattern in ("*.nbi", "*.nbc"):
        (path,) = tmp_path.rglob(pattern)
        path.write_bytes(damage)
        assert made([tmp_path], tmp_path, monkeypatch) == ["doubled"]
        assert made([tmp_path], tmp_path, monkeypatch) == []


def test_the_folder_that_numba_is_told_is_taken_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "told"))
    for place in (kernels._folders, kernels.cache_folder):
        place.cache_clear()
    try:
        assert kernels.cache_folder() == kernels._folders()[0] == tmp_path / "told"
        assert kernels.PACKAGE / "__pycache__" / "kernels" in kernels._folders()
    finally:
        for place in (kernels._folders, kernels.cache_folder):
            place.cache_clear()
