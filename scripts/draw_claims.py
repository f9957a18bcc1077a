"""Draws numbers that README and docs claim, to be measured again: `python scripts/draw_claims.py --date 2026-11-29`.

A page counts if it names a command that can be run. A claim is a number with a unit, a comparison or decimals in a
sentence or a row of a table; its command is the last one before it on the page, or the first. The date is the seed, so
that nobody chooses the claims. Left out, after the draw and with their count, is what measures nothing that is here: a
version, what something had "before", what is "wanted", and columns of the paper, of the demo, and of bars. The table's
last columns are for whoever runs the commands.
"""

import argparse
import random
import re
from collections import Counter
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
COMMAND = re.compile(r"^(?:\s{4}|\$ ?)?((?:[A-Z_]+=\S+ )*(?:echoavatar|python|pytest) [^#|`]+)")
UNITS = r"(?:%|ms|s|MB|GiB|mm|cm|m|fps|dB|Hz|kHz|words|sessions|times|minutes|seconds|hours|cores|frames)"
NUMBER = re.compile(
    rf"(?<![\w./-])[+-]?\d[\d,]*(?:\.\d+)?(?= {UNITS}\b| ?%|\s*(?:\||\*\*|\[|\+-|±))|(?<![\w./-])\d+\.\d+\b"
)
NOT_HERE = re.compile(r"\b(before|wanted) $")
COLUMNS = re.compile(r"\b(paper|demo|wanted)\b")


class Claim(NamedTuple):
    """A claimed number, its place, its sentence or row, and the command of its section."""

    number: str
    file: str
    line: int
    sentence: str
    command: str
    left_out: str = ""  # why it is nothing to measure


def claims(path: Path) -> list[Claim]:
    """The claims of a page, none if it names no command."""
    found, command, first, is_code = [], "", "", False
    paragraph: list[tuple[int, str]] = []
    header: list[str] = []
    for number, line in enumerate([*path.read_text(encoding="utf-8").splitlines(), ""], 1):
        is_text = bool(line.strip()) and not is_code and not line.startswith(("```", "    ", "#", "|"))
        if is_text and not line.startswith("- "):
            paragraph.append((number, line))
            continue
        rows = [[(number, line)]] if line.startswith("|") and not is_code else []
        header = header or line.split("|") if rows else []
        for told in [paragraph, *rows]:
            found += [
                Claim(value, str(path.relative_to(ROOT)), at, said, command, why)
                for at, said, value, why in spoken(told, header)
            ]
        paragraph = [(number, line)] if is_text else []
        if line.startswith("```"):
            is_code = not is_code
        elif (is_code or line.startswith("    ")) and (said := COMMAND.match(line)):
            command = said[1].strip().removesuffix("\\").strip()
            first = first or command
    return [one._replace(command=one.command or first) for one in found] if first else []


def spoken(told: list[tuple[int, str]], header: list[str]) -> Iterator[tuple[int, str, str, str]]:
    """Line, sentence and number of everything that a paragraph, or a row of a table, claims, and why it is left out."""
    whole = " ".join(line for _, line in told)
    ends = [sum(len(line) + 1 for _, line in told[: k + 1]) for k in range(len(told))]
    start = 0
    for said in [whole] if whole.startswith("|") else re.split(r"(?<=[.:;])(?= )", whole):
        plain = re.sub(r"`[^`]*`|\]\([^)]*\)", lambda match: " " * len(match[0]), said)
        for value in NUMBER.finditer(plain):
            at = next(k for k, end in enumerate(ends) if start + value.start() < end)
            column = header[plain[: value.start()].count("|")] if plain.startswith("|") else ""
            yield told[at][0], said.strip(), value[0].strip(), why_left_out(plain, value, column)
        start += len(said)


def why_left_out(said: str, value: re.Match[str], column: str) -> str:
    """Why a number measures nothing that is here; empty if it does."""
    if re.match(r"\.\d", said[value.end() :]) or ("Python" in said and re.fullmatch(r"3\.\d+", value[0])):
        return "version"
    told = NOT_HERE.search(said[: value.start()])
    if not told and "(missed: " not in said[: value.start()]:  # what misses a bar is ours
        told = COLUMNS.search(column)
    return told[1] if told else ""


def draw(found: list[Claim], day: date, count: int) -> list[Claim]:
    """`count` claims of different places, or fewer, in the order drawn with the date as seed; more only add to them."""
    shuffled = random.Random(f"{day}").sample(found, len(found))
    places = {(one.file, one.line): one for one in shuffled if not one.left_out}
    return list(places.values())[:count]


def table(drawn: list[Claim]) -> str:
    """The claims in Markdown, with columns to be filled."""
    rows = ["| place | claimed | sentence | command | got | interval |", "|---|---:|---|---|---|---|"]
    for one in drawn:
        sentence = one.sentence.replace("|", "/").strip(" /")
        rows.append(f"| {one.file}:{one.line} | {one.number} | {sentence} | `{one.command}` | | |")
    return "\n".join(rows)


def main() -> None:
    """Draw and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--date", type=date.fromisoformat, required=True, help="the seed, as 2026-11-29")
    parser.add_argument("--count", type=int, default=10, help="claims to draw (default: %(default)s)")
    args = parser.parse_args()
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    found = [claim for page in pages for claim in claims(page)]
    left_out = Counter(one.left_out for one in found if one.left_out)
    print(f"{len(found)} numbers claimed; {args.count} drawn with {args.date}; left out: {dict(left_out)}\n")
    print(table(draw(found, args.date, args.count)))


if __name__ == "__main__":
    main()
