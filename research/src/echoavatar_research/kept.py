"""Parts that are made once: a folder with `asked.json`, which says what was asked for and whether it is finished."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from echoavatar.errors import EchoAvatarError

STAMP = "asked.json"


def kept(folder: Path, asked: Mapping[str, object], make: Callable[[], object]) -> None:
    """Make a part unless it is finished; one that was broken off is made again, or gone on with, by `make`.

    Raises:
        EchoAvatarError: the folder holds a part made by other settings.
    """
    stamp, wanted = folder / STAMP, json.loads(json.dumps(asked))
    if stamp.exists():
        found = json.loads(stamp.read_text())
        if found["asked"] != wanted:
            raise EchoAvatarError(
                f"{folder} was made with other settings or from other parts; remove it or choose another -o"
            )
        if found["is_finished"]:
            return
    folder.mkdir(parents=True, exist_ok=True)
    _write(stamp, wanted, is_finished=False)
    make()
    _write(stamp, wanted, is_finished=True)


def _write(stamp: Path, asked: object, *, is_finished: bool) -> None:
    stamp.write_text(json.dumps({"asked": asked, "is_finished": is_finished}, indent=1) + "\n")
