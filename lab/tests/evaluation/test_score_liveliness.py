import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar_lab.evaluation.metrics.liveliness import STATISTICS
from echoavatar_lab.evaluation.motion_folder import Pair
from echoavatar_lab.evaluation.score_liveliness import clip_statistics, liveliness_rows


def test_a_row_for_each_statistic_with_the_truth_beside() -> None:
    """Smaller swings: slower hands than the truth's."""
    pairs = [Pair(f"{n}", swaying(240, size=0.1), swaying(240), None, np.ones(240, int)) for n in range(2)]
    rows = {row.name: row for row in liveliness_rows(pairs)}
    assert list(rows) == list(STATISTICS)
    assert 0 < rows["hand_speed"].value < rows["hand_speed"].truth
    assert rows["hand_speed"].truth == pytest.approx(clip_statistics(swaying(240))[0])


def test_a_short_clip_has_no_novelty() -> None:
    assert np.isnan(clip_statistics(swaying(60))[list(STATISTICS).index("novelty")])
