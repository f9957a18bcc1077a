"""The known captured sets: what their files show, which movement is noise, and what is cut off. Not in the paper.

A file of no known set counts if one of the folders on its way is named after a kind, such as `dance/mine.bvh`, or if
its name tells that somebody talks or dances.
"""

from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import PurePath
from typing import Literal

Kind = Literal["standing", "speech", "gesture", "dance", "action", "unit"]  # the last is cut from files by a table
WORDS: dict[str, Kind] = {"talk": "speech", "conversation": "speech", "dance": "dance"}
KINDS: tuple[Kind, ...] = ("standing", "speech", "gesture", "dance", "action")


@dataclass(frozen=True)
class Entry:
    """Files of one set that are treated alike.

    Attributes:
        pattern: of the folder and the file's name without suffix, as in `cmu_dance/60_*`.
        kind: what the body does.
        group: clips of one group look alike.
        cutoff_hz: faster movement is taken for noise; captured people gesture below 6 Hz.
        toes_hz: the same for feet and toes.
        last_s: seconds cut off at the end.
        is_head_frozen: whether the head was lost in capture, and follows the chest instead.
    """

    pattern: str
    kind: Kind
    group: str
    cutoff_hz: float = 8.0
    toes_hz: float = 8.0
    last_s: float = 0.0
    is_head_frozen: bool = False


ENTRIES = (
    Entry("reactidle_mit/*_acted", "standing", "acted", cutoff_hz=4.0, toes_hz=2.0),
    Entry("reactidle_mit/*_genuine", "standing", "genuine", cutoff_hz=4.0, toes_hz=2.0),
    Entry("accad_cc_by/Male1_A1_*", "standing", "stands", last_s=1.2),
    Entry("accad_cc_by/*_Stand", "standing", "stands"),
    Entry("accad_cc_by/*_Sway*", "standing", "sways"),
    Entry("accad_cc_by/*_Swing*", "standing", "swings"),
    Entry("accad_cc_by/*_Look*", "standing", "looks"),
    Entry("accad_cc_by/*_Wait", "standing", "waits"),
    Entry("accad_cc_by/*_D1_Urban", "speech", "attitudes"),
    Entry("accad_cc_by/*_D3_*", "speech", "talks", last_s=1.5),
    Entry("accad_cc_by/*_D4_*", "action", "gymnastics"),
    Entry("accad_cc_by/*_D5_*", "dance", "modern"),
    Entry("movebox_rocketbox_mit/rb_idle_*", "standing", "stands"),
    Entry("movebox_rocketbox_mit/rb_conversation", "speech", "talks"),
    Entry("hifi_apache2/idle", "standing", "stands"),
    Entry("hifi_apache2/talk", "speech", "talks"),
    Entry("hifi_talk_apache2/*", "speech", "talks"),
    Entry("hifi_apache2/*", "action", "steps"),
    Entry("cmu_gesture/13_26", "gesture", "signals"),
    Entry("cmu_gesture/13_*", "gesture", "laughs"),
    Entry("cmu_gesture/14_*", "gesture", "laughs"),
    Entry("cmu_gesture/141_*", "gesture", "waves", toes_hz=4.0),
    Entry("cmu_gesture/basketball_signals_*", "gesture", "signals"),
    Entry("cmu_dance/60_0[67]", "dance", "salsa_lead", is_head_frozen=True),
    Entry("cmu_dance/60_*", "dance", "salsa_lead"),
    Entry("cmu_dance/61_*", "dance", "salsa_follow"),
    Entry("cmu_dance/05_*", "dance", "modern", cutoff_hz=7.0, toes_hz=4.0),
    Entry("cmu_dance/49_*", "dance", "modern", cutoff_hz=7.0, toes_hz=4.0),
    Entry("cmu_dance/55_*", "dance", "whirl"),
    Entry("cmu_dance/85_*", "dance", "street"),
    Entry("mesh2motion_cc0/dance_*", "dance", "keyed"),
    Entry("mesh2motion_cc0/*", "action", "keyed"),
)


def entry_of(path: PurePath) -> Entry | None:
    """The entry of a file, by the end of its path; None for a file that is not to be read."""
    name = f"{path.parent.name}/{path.stem}"
    found = next((entry for entry in ENTRIES if fnmatch(name, entry.pattern)), None)
    if found is None:
        kind = next((kind for kind in KINDS if kind in path.parts[:-1]), None)
        kind = kind or next((kind for word, kind in WORDS.items() if word in path.stem), None)
        found = Entry(name, kind, path.parent.name) if kind else None
    return found
