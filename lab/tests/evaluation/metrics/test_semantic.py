from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.evaluation.metrics.semantic import BEAT_MEAN, read_labels, srgr

# emage_evaltools, SRGR(0.1, 5), on the arrays below, with and without labels, computed once
WITH, WITHOUT = 1.5058783983, 0.5733333333


def sides() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    true = random.normal(0, 1, (30, 5, 3))
    return true + random.normal(0, 0.06, true.shape), true, random.uniform(0, 1, 30)


def test_the_formula_is_beats() -> None:
    made, true, labels = sides()
    assert srgr(made, true, labels) == pytest.approx(WITH)
    assert srgr(made, true) == pytest.approx(WITHOUT)


def test_only_labelled_frames_count_and_a_truth_of_beats_mean_scores_one() -> None:
    made, true, _ = sides()
    assert srgr(true, true, np.full(30, BEAT_MEAN)) == pytest.approx(1)
    labels = np.zeros(30)
    labels[:10] = 1
    broken = true.copy()
    broken[10:] += 5  # where nothing is meant
    assert srgr(broken, true, labels) == srgr(true, true, labels) > srgr(true + 1, true, labels) == 0


def test_labels_are_read_from_beats_files(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("deictic_l\t0.5\t1.0\t0.5\t0.8\tthere\n\nbeat_align\t2.0\t2.1\t0.1\t0.1\t\n")
    labels = read_labels(path, 90)
    assert labels[[14, 15, 30, 31, 60, 63, 64]].tolist() == [0, 0.8, 0.8, 0, 0.1, 0.1, 0]
    path.write_text("deictic_l 0.5 1.0\n")
    with pytest.raises(EchoAvatarError, match=r"a\.txt, line 1: .* has no start, end and score"):
        read_labels(path, 90)
