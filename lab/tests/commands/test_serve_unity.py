from pathlib import Path

import pytest

from echoavatar.cli import main


def test_a_bundle_for_another_rig_is_refused(tiny_bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "--sink", "unity://127.0.0.1:9", "--model", str(tiny_bundle)]) == 1
    assert "is not made for that Unity project's rig" in capsys.readouterr().err
