import json
import os
import signal
import threading

import pytest
import torch
from lab.tests.training.line import CONFIG, Line, weights

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.training import Interrupted, train
from echoavatar_lab.training.run import Signals
from echoavatar_lab.training.state import FILE, read


def test_the_first_signal_is_noted_and_the_second_raises():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    try:
        with Signals() as signals:
            assert signals.number == 0
            os.kill(os.getpid(), signal.SIGINT)
            assert signals.number == signal.SIGINT
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_handlers_are_put_back():
    before = signal.getsignal(signal.SIGTERM)
    with Signals():
        assert signal.getsignal(signal.SIGTERM) is not before
    assert signal.getsignal(signal.SIGTERM) is before


def test_in_another_thread_nothing_is_touched():
    before, seen = signal.getsignal(signal.SIGTERM), []

    def enter():
        with Signals():
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert seen == [before]


def test_an_interruption_is_no_error_and_knows_its_exit_code():
    stopped = Interrupted("stopped", signal.SIGTERM)
    assert isinstance(stopped, KeyboardInterrupt)
    assert stopped.code == 143


def lines(folder):
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def told(folder):
    return [(line["step"], line["loss"]) for line in lines(folder) if "loss" in line]


def test_a_run_killed_between_checkpoints_repeats_what_it_lost(tmp_path):
    """Killed after step 5, last saved at step 3: steps 4 and 5 are told once, and alike."""

    class KilledError(Exception):
        pass

    def kill(step, _):
        if step == 5:
            raise KilledError

    torch.manual_seed(1)
    whole, killed = Line(), Line()
    train(whole, tmp_path / "whole")
    torch.manual_seed(1)
    with pytest.raises(KilledError):
        train(killed, tmp_path / "killed", progress=kill)
    again = Line()
    train(again, tmp_path / "killed")
    assert told(tmp_path / "killed") == told(tmp_path / "whole")
    assert [step for step, _ in told(tmp_path / "whole")] == list(range(1, 13))
    assert torch.equal(weights(again), weights(whole))


def test_time_runs_out_and_the_run_goes_on_later(tmp_path):
    train(Line(), tmp_path, minutes=0.0)
    assert told(tmp_path) == []
    train(Line(), tmp_path)
    assert len(told(tmp_path)) == 12
    train(Line(), tmp_path)
    assert len(told(tmp_path)) == 12


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_run_after_the_step_with_a_checkpoint(tmp_path, number):
    """Sent during step 7, which no checkpoint falls on; the run goes on to what it would have been."""
    torch.manual_seed(1)
    train(Line(), tmp_path / "whole")

    def send(step, _):
        if step == 7:
            os.kill(os.getpid(), number)

    torch.manual_seed(1)
    before = signal.getsignal(number)
    with pytest.raises(Interrupted, match="step 7 of 12") as stopped:
        train(Line(), tmp_path / "cut", progress=send)
    assert stopped.value.code == 128 + number
    assert signal.getsignal(number) is before
    assert len(told(tmp_path / "cut")) == 7
    train(Line(), tmp_path / "cut")
    assert told(tmp_path / "cut") == told(tmp_path / "whole")


def test_metrics_are_logged_and_measured_at_their_intervals(tmp_path):
    config = CONFIG.model_copy(update={"log_every": 4, "evaluate_every": 5})
    train(Line(config), tmp_path)
    assert [step for step, _ in told(tmp_path)] == [4, 8, 12]
    assert [line["step"] for line in lines(tmp_path) if "held_out" in line] == [5, 10]
    assert {"step", "loss", "error", "x", "gradient", "rate", "seconds"} == set(lines(tmp_path)[0])


def test_weights_that_are_no_numbers_are_not_kept(tmp_path):
    """Broken during step 5 of a run that tells nothing: it ends at step 6, where it would have saved."""
    stage = Line(CONFIG.model_copy(update={"log_every": 100}))

    def spoil(step, _):
        if step == 5:
            with torch.no_grad():
                next(stage.modules["layers"].parameters()).fill_(float("nan"))

    with pytest.raises(EchoAvatarError, match="the loss is nan at step 6"):
        train(stage, tmp_path, progress=spoil)
    _, facts = read(tmp_path / FILE)
    assert facts["step"] == 3
