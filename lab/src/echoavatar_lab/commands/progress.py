"""A progress bar for work that tells its name and how much of it is done."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """Call what it gives with the name of the work, the steps done and the steps in all; silent without a terminal."""
    with tqdm(disable=not sys.stderr.isatty()) as bar:

        def say(what: str, done: int, total: int) -> None:
            bar.set_description(what, refresh=False)
            bar.total = total
            bar.n = done
            bar.refresh()

        yield say
