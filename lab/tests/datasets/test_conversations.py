from itertools import islice
from pathlib import Path

import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.datasets.conversations import OWN, RULE, conversations


def test_scripts_come_from_the_file_then_shipped_then_generated(tmp_path: Path) -> None:
    file = tmp_path / "talk.txt"
    file.write_text("# a comment\nAnna: Hello there; who is it?\nBo: Me!\nAnna: Oh.\n\n\nAlone: one\nplain line\n")
    found = list(islice(conversations(0, file), 14))
    assert [script.source for script in found[:3]] == ["talk.txt", "talk.txt", OWN]
    assert found[-1].source == RULE
    first = found[0].turns
    assert [(turn.speaker, turn.text) for turn in first] == [
        (0, "Hello there; who is it?"), (1, "Me!"), (0, "Oh."),
    ]  # fmt: skip
    assert [word.text + word.mark for word in first[0].sentences[0].words] == [
        "Hello", "there,", "who", "is", "it?",
    ]  # fmt: skip
    assert [turn.speaker for turn in found[1].turns] == [0, 1]


def test_shipped_scripts_can_be_spoken_and_one_in_ten_is_held_out() -> None:
    found = list(islice(conversations(0), 40))
    assert len({script.name for script in found}) == 40
    assert all(turn.sentences for script in found for turn in script.turns)
    assert all(word.text for script in found for turn in script.turns for s in turn.sentences for word in s.words)
    assert sum(script.split == "test" for script in found) == 4


def test_each_depends_on_the_seed_and_its_number() -> None:
    def text(seed: int) -> list[str]:
        return [turn.text for script in islice(conversations(seed), 12, 15) for turn in script.turns]

    assert text(1) == text(1) != text(2)


def test_text_without_known_letters_has_no_sentences(tmp_path: Path) -> None:
    file = tmp_path / "talk.txt"
    file.write_text("你好。")
    assert next(conversations(0, file)).turns[0].sentences == ()


def test_unreadable_and_empty_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="cannot be read as UTF-8"):
        next(conversations(0, tmp_path / "none.txt"))
    (tmp_path / "empty.txt").write_text("# nothing\n")
    with pytest.raises(EchoAvatarError, match="holds no text"):
        next(conversations(0, tmp_path / "empty.txt"))
