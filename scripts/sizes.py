"""How large the project is: files and lines of Python of each part, and words of Markdown.

    python scripts/sizes.py

Counts what git tracks. The avatar is what users install (`src`), the lab makes what it runs (`lab/src`).
"""

import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
PARTS = {
    "avatar": ("src/*.py",),
    "lab": ("lab/src/*.py",),
    "studio": ("studio/src/*.py",),
    "character tools": ("tools/*/src/*.py",),
    "integrations": ("integrations/*.py",),
    "scripts": ("scripts/*.py",),
    "tests": ("tests/*.py", "*/tests/*.py", "tools/*/tests/*.py"),
}


def tracked(*patterns: str) -> list[Path]:
    """Files that git tracks, by patterns in which * also matches folders."""
    names = subprocess.run(["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=True)
    return [ROOT / name for name in names.stdout.splitlines()]


def main() -> None:
    """Print the table."""
    print(f"{'':<18}{'files':>8}{'lines':>9}{'longest':>9}")
    for part, patterns in PARTS.items():
        lines = [len(path.read_text("utf-8").splitlines()) for path in tracked(*patterns)]
        print(f"{part:<18}{len(lines):>8}{sum(lines):>9}{max(lines, default=0):>9}")
    pages = tracked("*.md")
    words = sum(len(path.read_text("utf-8").split()) for path in pages)
    print(f"{'Markdown':<18}{len(pages):>8} pages, {words} words")


if __name__ == "__main__":
    main()
