import json
from pathlib import Path

import pytest
from lab.tests.evaluation.test_takes import captured, write_sound

from echoavatar.cli import main
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.commands.evaluate_measures import write_card


@pytest.mark.parametrize("measure", ["drift", "dial", "rests"])
def test_what_performs_sound_asks_for_recordings(measure: str, tiny_bundle: Path, capsys) -> None:
    assert main(["evaluate", str(tiny_bundle), measure]) == 1
    assert "--recordings" in capsys.readouterr().err


def test_a_model_without_manners_has_no_dials(tmp_path: Path, tiny_bundle: Path, capsys) -> None:
    write_sound(tmp_path / "voices" / "ann.wav", 22)
    asked = ["evaluate", str(tiny_bundle), "dial", "--recordings", str(tmp_path / "voices"), "--clips", "1"]
    assert main([*asked, "--captured", str(captured(tmp_path / "people"))]) == 1
    assert "without manners" in capsys.readouterr().err


def test_numbers_join_a_card_that_is_there(tmp_path: Path) -> None:
    (tmp_path / "card.json").write_text('{"name": "mine", "people": 1}', "utf-8")
    write_card(tmp_path / "card.json", "people", "echoavatar evaluate BUNDLE people", {"speech": 2})
    kept = json.loads((tmp_path / "card.json").read_text("utf-8"))
    assert kept == {"name": "mine", "people": {"command": "echoavatar evaluate BUNDLE people", "speech": 2}}
    with pytest.raises(EchoAvatarError, match=r"give its card\.json"):
        write_card(tmp_path / "none.json", "people", "", {})
