"""Any folder of BVH files. The sound of a clip has the same file name, beside it or in a folder of sounds.

A path that contains "music" or "dance" marks its sound as music; any other sound is speech. Sub-folders named train,
val or test give the split.
"""

import re
from pathlib import Path

from .source import Domain, Recording, Survey, Terms, files_below

TERMS = Terms(
    title="a folder of BVH",
    origin="the user's own",
    licence="unknown; write it into the manifest before you pass anything on",
    may_ship="what the files' own licence allows",
)
SOUNDS = (".wav", ".flac", ".ogg", ".opus", ".mp3", ".m4a")
_TWINS = ("wav", "audio", "sound")  # beside a folder bvh/ or motion/
_MUSIC = re.compile(r"music|dance", re.IGNORECASE)


def survey(folder: Path) -> Survey:
    """Find every BVH below the folder."""
    recordings = []
    for path in files_below(folder, ".bvh"):
        relative = path.relative_to(folder).with_suffix("")
        split = next((part for part in relative.parts[:-1] if part in ("train", "val", "test")), "")
        domain: Domain = "music" if _MUSIC.search(str(relative)) else "speech"
        name = re.sub(r"[^\w.+-]+", "_", "__".join(relative.parts))
        recordings.append(Recording(name, path, _sound_of(path), domain, split))
    has_split = any(recording.split for recording in recordings)
    return Survey(TERMS, recordings, (), (), "folders named train, val, test" if has_split else "every tenth by name")


def _sound_of(path: Path) -> Path:
    """The sound file of a motion; if there is none, the path where it would be expected."""
    folders = [path.parent, *(path.parent.parent / twin for twin in _TWINS)]
    for folder in folders:
        for suffix in SOUNDS:
            if (sound := folder / f"{path.stem}{suffix}").is_file():
                return sound
    return path.with_suffix(".wav")
