"""`align compare` measures what is given and writes what it prints."""

import json
from pathlib import Path

from tests.align.scenes import yardstick
from tests.align.tuning import clips

from echoavatar.cli import main


def test_generators_side_by_side(tmp_path: Path, tiny_bundle: Path, capsys) -> None:
    folder = tmp_path / "tokens"
    folder.mkdir()
    for number, (name, clip) in enumerate(clips(3, chunks=8).items()):
        if number == 2:
            object.__setattr__(clip, "split", "test")
        clip.save(folder / f"{name}.npz")
    yardstick().save(tmp_path / "yardstick.json")
    words = ["--bundle", str(tiny_bundle), "--yardstick", str(tmp_path / "yardstick.json")]
    words += ["--reward", "smoothness=1", "--prompts", "2", "--group", "2", "--past", "2", "--length", "4"]
    words += ["--beside", str(tiny_bundle / "generator"), "-o", str(tmp_path / "found.json")]
    assert main(["align", "compare", str(folder), *words]) == 0
    told = json.loads((tmp_path / "found.json").read_text())
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == told
    assert list(told["found"]) == ["truth", "untuned", str(tiny_bundle / "generator")]
    assert told["prompts"] == 2
