import pytest

from echoavatar_lab.corpora.dance.grooves import GROOVES
from echoavatar_lab.corpora.dance.moves import MOVES, fitting
from echoavatar_lab.corpora.dance.poses import ARMS


def test_moves_use_known_poses_and_stay_within_their_counts() -> None:
    for move in MOVES:
        assert all({key.left, key.right} <= set(ARMS) for key in move.keys), move.name
        counts = [key.count for key in move.keys]
        assert counts == sorted(set(counts))
        assert counts[0] >= 0
        assert counts[-1] < move.counts


@pytest.mark.parametrize("energy", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("style", sorted(GROOVES))
def test_every_style_finds_moves(style: str, energy: float) -> None:
    assert all(not move.styles or style in move.styles for move in fitting(style, energy))
    assert fitting(style, energy)
