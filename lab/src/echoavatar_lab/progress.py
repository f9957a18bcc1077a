"""How far long work has come: the work tells what is done and what there is, and a bar shows it."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from tqdm import tqdm

ItemT = TypeVar("ItemT")
Progress = Callable[[int, int], None]
"""Called with what is done and what there is."""


def watched(items: Sequence[ItemT], progress: Progress | None) -> Iterator[ItemT]:
    """The items one after another; `progress` is called after each."""
    for done, item in enumerate(items, 1):
        yield item
        if progress is not None:
            progress(done, len(items))


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float, float], None]]:
    """Context with a function to call with the work's name, what is done and what there is; silent off a terminal."""
    with tqdm(disable=not sys.stderr.isatty()) as bar:

        def say(what: str, done: float, total: float) -> None:
            bar.set_description(what, refresh=False)
            bar.total = round(total, 2)
            bar.n = round(done, 2)
            bar.refresh()

        yield say
