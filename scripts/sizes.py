"""How large the project is: files and lines of Python of each part, and words of Markdown.

    python scripts/sizes.py
    python scripts/sizes.py --since COMMIT src/echoavatar/motion/formats src/echoavatar/models/audio

Counts what git tracks. The avatar is what users install (`src`), the lab makes what it runs (`lab/src`). With
`--since`, the lines of each file of these folders, data as well, at a commit and now.
"""

import argparse
import subprocess
from collections import Counter
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


def git(*words: str) -> list[str]:
    """The lines that git says; none where it finds nothing."""
    done = subprocess.run(["git", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    if done.returncode > 1:
        raise SystemExit(done.returncode)
    return done.stdout.splitlines()


def tracked(*patterns: str) -> list[Path]:
    """Files that git tracks, by patterns in which * also matches folders."""
    return [ROOT / name for name in git("ls-files", *patterns)]


def lines_of(folder: str, *commit: str) -> Counter[str]:
    """The lines of each file of code or data in a folder, now or at a commit."""
    kinds = [f":(glob){folder}/**/*.{kind}" for kind in ("py", "toml", "json", "csv")]
    found = (line.rsplit(":", 2)[-2:] for line in git("grep", "-c", "", *commit, "--", *kinds))
    return Counter({name: int(count) for name, count in found})


def print_since(commit: str, folders: list[str]) -> None:
    """Print the lines of each file of some folders at a commit and now."""
    sums: Counter[bool] = Counter()
    print(f"{'':<58}{'then':>7}{'now':>7}")
    for folder in folders:
        before, after = lines_of(folder, commit), lines_of(folder)
        for name in sorted(before | after):
            print(f"  {name:<56}{before[name]:>7}{after[name]:>7}")
        print(f"{folder:<58}{before.total():>7}{after.total():>7}")
        sums += Counter({False: before.total(), True: after.total()})
    print(f"{'together':<58}{sums[False]:>7}{sums[True]:>7}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--since", metavar="COMMIT", help="compare with this commit")
    parser.add_argument("folders", nargs="*", default=["src"])
    args = parser.parse_args()
    if args.since:
        return print_since(args.since, args.folders)
    print(f"{'':<18}{'files':>8}{'lines':>9}{'longest':>9}")
    for part, patterns in PARTS.items():
        lines = [len(path.read_text("utf-8").splitlines()) for path in tracked(*patterns)]
        print(f"{part:<18}{len(lines):>8}{sum(lines):>9}{max(lines, default=0):>9}")
    pages = tracked("*.md")
    words = sum(len(path.read_text("utf-8").split()) for path in pages)
    print(f"{'Markdown':<18}{len(pages):>8} pages, {words} words")


if __name__ == "__main__":
    main()
