from pathlib import Path

import pytest

from echoavatar.bench.stream import StreamReport
from echoavatar.models.face import MelConfig
from echoavatar_lab.tables import latency
from echoavatar_lab.tables.experiment import Experiment
from echoavatar_lab.tables.latency import hardware
from echoavatar_lab.tables.scale import PAPER


def test_hardware_is_named() -> None:
    assert "cores" in hardware("cpu")


TIMES = {"level": 1, "face": 9, "codec": 2, "generator": 4, "decoder": 8, "rig": 16, "feet": 32, "whole chunk": 72}


def test_stages_are_gathered_as_the_paper_does() -> None:
    report = StreamReport({k: (float(v), 2.0 * v, 3.0 * v) for k, v in TIMES.items()}, {})
    found = {name: latency._cells(report, name)["p50"].value for name in latency.PAPER_MS}
    assert found == {
        "Audio Encoder": 3,
        "Audio-to-Motion Model": 4,
        "Motion Decoder": 8,
        "IK Post-processing": 48,
        "Total Latency": 72,
    }


def test_the_papers_stages_make_its_total_but_for_the_face() -> None:
    """169.15 of 177.43 ms on the H200: the paper does not say what the rest is."""
    for device in (0, 1):
        parts = sum(values[device] for name, values in latency.PAPER_MS.items() if name != "Total Latency")
        assert parts < latency.PAPER_MS["Total Latency"][device]


def test_the_papers_scale_times_the_papers_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All four have the paper's sizes; here smaller ones of the same form are timed."""
    asked = latency.paper_sizes()
    assert (asked.generator.sequence, asked.generator.width, asked.codec.filters) == ("prefix", 896, 32)
    assert (asked.face.encoder.kind, asked.face.width) == ("hubert", 256)
    assert {part.width for part in asked.tokenizer.parts.values()} == {512}
    small = latency.PaperSizes(
        asked.codec.model_copy(update={"filters": 4, "width": 8}),
        asked.tokenizer.model_copy(
            update={
                "parts": {
                    name: part.model_copy(update={"width": 32, "heads": 2})
                    for name, part in asked.tokenizer.parts.items()
                }
            }
        ),
        asked.generator.model_copy(update={"width": 32, "layers": 1, "heads": 2, "mlp": 32, "window_chunks": 2}),
        asked.face.model_copy(update={"encoder": MelConfig(width=16, blocks=1), "width": 16, "head_width": 16}),
    )
    monkeypatch.setattr(latency, "paper_sizes", lambda: small)
    experiment = Experiment(tmp_path, PAPER.model_copy(update={"seconds": 1.0}))
    table = latency.make(experiment)
    assert table.notes[0].startswith("paper's sizes, random weights: ")
    assert all(line.ours["p50"].value > 0 for line in table.lines)
