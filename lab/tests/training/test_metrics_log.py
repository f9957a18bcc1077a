import json
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType

import pytest

from echoavatar.errors import DependencyError
from echoavatar_lab.training.metrics_log import FILE, MetricsLog


def test_lines_that_will_be_repeated_and_a_torn_one_are_dropped(tmp_path):
    (tmp_path / FILE).write_text('{"step": 1, "loss": 3}\n{"step": 2, "loss": 2}\n{"step": 3, "lo')
    journal = MetricsLog(tmp_path, 1)
    journal.write(2, {"loss": 2.5})
    journal.close()
    read = [json.loads(line) for line in (tmp_path / FILE).read_text().splitlines()]
    assert read == [{"step": 1, "loss": 3}, {"step": 2, "loss": 2.5}]


@pytest.mark.parametrize("name", ["tensorboard", "wandb"])
def test_a_tracker_that_is_not_installed_is_named(tmp_path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DependencyError, match=f"--track {name} .*pip install {name}"):
        MetricsLog(tmp_path, 0, [name])


def test_weights_and_biases_goes_on_with_the_same_run(tmp_path, monkeypatch):
    """A stand-in that notes what it is told."""
    told, asked = [], []

    class Run:
        id = "abc"

        def log(self, values, step):
            told.append((step, values))

        def finish(self):
            told.append("finished")

    fake = ModuleType("wandb")
    fake.__spec__ = ModuleSpec("wandb", None)
    fake.init = lambda **options: asked.append(options["id"]) or Run()
    monkeypatch.setitem(sys.modules, "wandb", fake)
    for step in (1, 2):
        journal = MetricsLog(tmp_path, 0, ["wandb"])
        journal.write(step, {"loss": 0.5})
        journal.close()
    assert asked == [None, "abc"]
    assert told == [(1, {"loss": 0.5}), "finished", (2, {"loss": 0.5}), "finished"]


def test_tensorboard_gets_every_value(tmp_path, monkeypatch):
    told = []

    class Writer:
        def __init__(self, folder):
            assert folder == tmp_path / "tensorboard"

        def add_scalar(self, name, value, step):
            told.append((name, value, step))

        def close(self):
            told.append("closed")

    fake = ModuleType("torch.utils.tensorboard")
    fake.SummaryWriter = Writer
    fake.__spec__ = ModuleSpec("tensorboard", None)
    for name in ("tensorboard", "torch.utils.tensorboard"):
        monkeypatch.setitem(sys.modules, name, fake)
    journal = MetricsLog(tmp_path, 0, ["tensorboard"])
    journal.write(3, {"loss": 0.5, "rate": 0.1})
    journal.close()
    assert told == [("loss", 0.5, 3), ("rate", 0.1, 3), "closed"]
