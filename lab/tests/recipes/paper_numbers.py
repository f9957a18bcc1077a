"""Reads `paper_numbers.csv`: the paper's numbers as typed from it, with their places and what holds them here."""

import csv
from pathlib import Path

NUMBERS = Path(__file__).with_name("paper_numbers.csv")


def rows() -> list[dict[str, str]]:
    """Every row; `held by` is empty where no recipe has the number."""
    with NUMBERS.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def number(what: str) -> float:
    """The paper's number of that name."""
    return float(next(row["value"] for row in rows() if row["what"] == what))
