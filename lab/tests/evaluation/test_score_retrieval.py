from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.evaluation.score_retrieval import read_embeddings, retrieval_rows


def embeddings(pairs: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    audio = random.normal(size=(pairs, 32))
    return audio, audio + noise * random.normal(size=audio.shape)


def test_a_gallery_of_300_stands_beside_all_where_there_are_more() -> None:
    rows = {row.name: row for row in retrieval_rows(*embeddings(400, 1.0))}
    assert len(rows) == 20
    assert rows["a2m_r1_300"].value >= rows["a2m_r1_all"].value
    assert rows["a2m_r1_all"].chance == pytest.approx(0.25)
    assert len(retrieval_rows(*embeddings(100, 1.0))) == 10


def test_pairs_that_belong_together_are_over_chance_and_others_are_not() -> None:
    audio, motion = embeddings(200, 0.5)
    right = {row.name: row for row in retrieval_rows(audio, motion)}
    wrong = {row.name: row for row in retrieval_rows(audio, np.roll(motion, 1, 0))}
    assert right["m2a_mrr_all"].excess_interval.low > 50
    assert right["m2a_medr_all"].interval.high < 3
    assert wrong["m2a_r10_all"].interval.low < wrong["m2a_r10_all"].chance < 10


def test_files_that_do_not_fit_are_named(tmp_path: Path) -> None:
    path = tmp_path / "pairs.npz"
    with pytest.raises(EchoAvatarError, match="does not exist"):
        read_embeddings(path)
    path.write_bytes(b"no")
    with pytest.raises(EchoAvatarError, match="holds no arrays"):
        read_embeddings(path)
    np.savez(path, audio=np.zeros((3, 2)), motion=np.zeros((4, 2)))
    with pytest.raises(EchoAvatarError, match="pairs, size"):
        read_embeddings(path)
    np.savez(path, audio=np.full((3, 2), np.nan), motion=np.zeros((3, 2)))
    with pytest.raises(EchoAvatarError, match="not finite"):
        read_embeddings(path)
