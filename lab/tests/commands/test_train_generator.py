import os
import signal
from pathlib import Path

import pytest
from lab.tests.models.generator.test_train import clips

from echoavatar.checkpoint import read_card
from echoavatar.cli import main
from echoavatar.models.generator import Generator
from echoavatar_lab.training.run import Signals

RECIPE = "model: {width: 16, layers: 1, window_chunks: 3}\ntraining: {steps: 4, batch: 2, warmup: 1}\n"


@pytest.fixture
def words(tiny_bundle: Path, tmp_path: Path) -> list[str]:
    """A command that trains a generator of the tiny bundle's layout in moments."""
    (tmp_path / "tokens").mkdir()
    for at, clip in enumerate(clips()):
        clip.save(tmp_path / "tokens" / f"{at}.npz")
    (tmp_path / "r.yaml").write_text(RECIPE)
    parts = ["--codec", str(tiny_bundle / "codec"), "--tokenizer", str(tiny_bundle / "tokenizer")]
    return ["train", "generator", str(tmp_path / "tokens"), "--recipe", str(tmp_path / "r.yaml"), *parts]


def test_stages_follow_each_other(words: list[str], tmp_path: Path) -> None:
    """The third stage takes sets, and begins with what the second left; sizes and layers follow from the parts."""
    assert main([*words, "-o", str(tmp_path / "a")]) == 0
    assert main([*words, "-o", str(tmp_path / "b"), "--start", str(tmp_path / "a"), "--exemplar", "0.5"]) == 0
    model = Generator.load(tmp_path / "b")
    assert (model.config.width, model.config.mlp, model.config.exemplar) == (16, 48, True)
    training = read_card(tmp_path / "b")["training"]
    assert (training["chunks"], training["depth_weights"]) == (9, [1.0, 0.7])  # type: ignore[index]
    assert training["optimiser"] == "muon"  # type: ignore[index]


def test_a_run_that_is_ended_says_how_far_it_is_and_how_to_go_on(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    entered = Signals.__enter__

    def enter(signals: Signals) -> Signals:
        found = entered(signals)
        os.kill(os.getpid(), signal.SIGTERM)
        return found

    with monkeypatch.context() as patched:
        patched.setattr(Signals, "__enter__", enter)
        assert main([*words, "-o", str(tmp_path / "run")]) == 143
    assert "stopped at step 0 of 4" in capsys.readouterr().err
    assert main([*words, "-o", str(tmp_path / "run")]) == 0
    assert read_card(tmp_path / "run")["step"] == 4
