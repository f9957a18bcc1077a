from pathlib import Path

from echoavatar.corpora.capture.catalogue import entry_of


def test_known_sets_are_told_by_their_folder_and_name():
    assert entry_of(Path("x/cmu_dance/60_06.bvh")).is_head_frozen
    assert entry_of(Path("x/cmu_dance/61_01.bvh")).group == "salsa_follow"
    assert entry_of(Path("x/reactidle_mit/003_acted.bvh")).kind == "standing"
    assert entry_of(Path("accad_cc_by/Female1_D3_ConversationGestures.bvh")).last_s > 1


def test_other_files_count_by_the_folder_they_lie_in():
    mine = entry_of(Path("captured/dance/mine.bvh"))
    assert (mine.kind, mine.group) == ("dance", "dance")
    assert entry_of(Path("captured/holidays/mine.bvh")) is None
