from pathlib import Path

import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.evaluation import alive
from echoavatar_lab.evaluation.alive_picture import draw, sheet


def test_a_plot_and_a_row_of_stills_for_each_take(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the evaluate extra is not installed")
    takes = [alive.Take(f"{n}", "speech", "", swaying(330)) for n in range(2)]
    draw(alive.report([takes], takes, 11), tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000
    with pytest.raises(EchoAvatarError, match="cannot write"):
        draw(alive.report([takes], [], 11), tmp_path / "none/plot.png")
    assert sheet(takes[:1]).shape == (130, 12 * 90, 3)
