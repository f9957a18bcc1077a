"""Parts that are made once: each folder has an `asked.json` with the settings and whether the part is finished."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from echoavatar.errors import EchoAvatarError

STAMP = "asked.json"


def make_once(folder: Path, settings: Mapping[str, object], make: Callable[[], object]) -> None:
    """Call `make` unless the part is finished. After an interruption `make` is called again and may resume.

    Raises:
        EchoAvatarError: the folder holds a part that was made with other settings.
    """
    stamp, wanted = folder / STAMP, json.loads(json.dumps(settings))
    if stamp.exists():
        found = json.loads(stamp.read_text(encoding="utf-8"))
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


def _write(stamp: Path, settings: object, *, is_finished: bool) -> None:
    stamp.write_text(json.dumps({"asked": settings, "is_finished": is_finished}, indent=1) + "\n", encoding="utf-8")
