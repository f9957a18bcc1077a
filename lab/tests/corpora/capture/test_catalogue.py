from pathlib import Path

import pytest

from echoavatar_lab.corpora.capture.catalogue import entry_of


@pytest.mark.parametrize(
    ("path", "kind", "group"),
    [
        ("motion/cmu_dance/61_03.bvh", "dance", "salsa_follow"),
        ("motion/cmu_gesture/141_16.bvh", "gesture", "waves"),
        ("motion/accad_cc_by/Male1_A1_Stand.bvh", "standing", "stands"),
        ("motion/reactidle_mit/002_acted.bvh", "standing", "acted"),
        ("mine/dance/shuffle.bvh", "dance", "dance"),
        ("mine/my_talk.bvh", "speech", "mine"),
    ],
)
def test_files_are_known_by_set_folder_or_name(path, kind, group):
    entry = entry_of(Path(path))
    assert entry is not None
    assert (entry.kind, entry.group) == (kind, group)


def test_the_first_fitting_entry_counts_and_strangers_are_left_out():
    lost, kept = (entry_of(Path(f"cmu_dance/60_{number}.bvh")) for number in ("06", "05"))
    assert lost is not None
    assert kept is not None
    assert lost.is_head_frozen
    assert not kept.is_head_frozen
    assert entry_of(Path("somewhere/walk.bvh")) is None
