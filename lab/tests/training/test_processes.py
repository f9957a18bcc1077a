import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from lab.tests.training.line import CONFIG, Line

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar_lab.checkpoint import read_weights
from echoavatar_lab.training import Loop, TrainingTask
from echoavatar_lab.training.processes import Processes, processes_here

ROOT = Path(__file__).parents[3]


def launch(code: str, *args: str, count: int = 2) -> list[str]:
    """What each of so many processes printed, started as torchrun would."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    shared = os.environ | {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": str(count)}
    shared |= {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]), "OMP_NUM_THREADS": "1"}
    running = [
        subprocess.Popen(
            [sys.executable, "-c", code, *args],
            env=shared | {"RANK": str(rank), "LOCAL_RANK": str(rank)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(count)
    ]
    ended = [process.communicate(timeout=120) for process in running]
    for process in running:
        assert process.returncode == 0, "\n".join(errors[-1500:] for _, errors in ended)
    return [out for out, _ in ended]


def test_one_process_needs_nothing(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    here = processes_here()
    assert (here.count, here.rank, here.is_first, here.agree(True)) == (1, 0, True, True)
    assert here.gather_json({"a": 1.5}) == [{"a": 1.5}]
    with pytest.raises(EchoAvatarError, match="sharding is for several processes"):
        processes_here(sharded=True)


def test_several_processes_without_accelerate_say_what_to_install(monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setitem(sys.modules, "accelerate", None)
    with pytest.raises(DependencyError, match=r"echoavatar-lab\[train\]"):
        processes_here()


RUN = """
import json, sys
from pathlib import Path
import torch
from lab.tests.training.line import CONFIG, Line
from lab.tests.training.test_processes import curve, real_stages
from echoavatar_lab.training import Loop
from echoavatar_lab.training.processes import processes_here


def main():
    sharded, folder = sys.argv[1] == "sharded", Path(sys.argv[2])
    processes = processes_here(sharded=sharded)
    torch.manual_seed(0)
    config = CONFIG.model_copy(update={"accumulation": 2, "average": 0.9})
    loop = Loop(Line(config), processes)
    told = curve(loop, 4)
    loop.save(folder)
    again = Loop(Line(config), loop.processes)
    again.resume(folder)
    torch.manual_seed(1)
    first = curve(loop, 2)
    torch.manual_seed(1)
    assert curve(again, 2) == first
    stages = {name: stage for name, stage in real_stages(2).items() if name == "generator" or not sharded}
    print(json.dumps({"line": told} | {name: curve(Loop(stage, processes), 3) for name, stage in stages.items()}))

main()
"""


def curve(loop: Loop, steps: int) -> list[list[float]]:
    """Loss and gradient of each step."""
    return [[told["loss"], told["gradient"]] for told in (loop.advance() for _ in range(steps))]


def real_stages(pieces: int) -> dict[str, TrainingTask]:
    """A generator that is told cues and sets, and a tokenizer with noise on its codes."""
    from lab.tests.models.generator.test_train import clips, config, settings
    from lab.tests.models.tokenizer.test_train import CLIPS, TRAINING, small_config

    from echoavatar_lab.models.generator.train import GeneratorTask
    from echoavatar_lab.models.tokenizer.train import TokenizerTask

    lesson = settings(batch=8, accumulation=pieces, exemplar=0.5, cue_weight=0.1, optimiser="adamw")
    motion = TRAINING.model_copy(update={"accumulation": pieces})
    return {
        "generator": GeneratorTask(config(exemplar=True), lesson, clips()),
        "tokenizer": TokenizerTask(small_config(), motion, CLIPS),
    }


@pytest.mark.slow
@pytest.mark.parametrize("how", ["shared", "sharded"])
def test_two_processes_share_the_trajectory_of_one(tmp_path, how):
    """Two processes with two pieces each, against whole batches; one goes on with what two saved.

    A hundred-thousandth for losses and gradients: the same sums in another order, over some steps of AdamW.
    """
    pytest.importorskip("accelerate")
    torch.manual_seed(0)
    alone = Loop(Line(CONFIG.model_copy(update={"average": 0.9})), Processes())
    expected = {"line": curve(alone, 4)}
    expected |= {name: curve(Loop(stage), 3) for name, stage in real_stages(1).items()}
    for out in launch(RUN, how, str(tmp_path)):
        for name, found in json.loads(out).items():
            values, wanted = torch.tensor(found), torch.tensor(expected[name])
            torch.testing.assert_close(values, wanted, rtol=1e-5, atol=1e-5, msg=lambda m, n=name: f"{n}: {m}")
    one = Loop(Line(CONFIG.model_copy(update={"average": 0.9})))
    assert one.resume(tmp_path)
    saved = read_weights(tmp_path)
    for key, value in alone.average.values.items():
        torch.testing.assert_close(saved[key.removeprefix("layers.")], value, rtol=1e-5, atol=1e-6)
    for mine, theirs in zip(
        one.stage.modules["layers"].parameters(), alone.stage.modules["layers"].parameters(), strict=True
    ):
        torch.testing.assert_close(mine, theirs, rtol=1e-5, atol=1e-6)
