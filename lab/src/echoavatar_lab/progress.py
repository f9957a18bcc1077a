"""A progress bar for work that tells its name and how much of it is done."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


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
