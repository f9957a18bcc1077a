"""YAML that people write: what is read, what is refused in one error, and how long that takes."""

import time
from collections.abc import Callable

import pytest
import yaml

from echoavatar import yaml_reader
from echoavatar.errors import EchoAvatarError
from echoavatar.yaml_reader import read_yaml

HAS_C = yaml.__with_libyaml__
LOADERS = [yaml.SafeLoader, *([yaml.CSafeLoader] if HAS_C else [])]


def seconds(what: Callable[[], object]) -> float:
    """The processor's time for it."""
    began = time.thread_time()
    what()
    return time.thread_time() - began


@pytest.fixture(params=LOADERS, ids=lambda loader: loader.__name__)
def loader(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of PyYAML's readers in turn."""
    monkeypatch.setattr(yaml_reader, "_LOADER", request.param)


@pytest.mark.usefixtures("loader")
def test_plain_values_are_read() -> None:
    text = "kind: pairwise  # a comment\nsounds:\n  - {path: a b, start: 1.5}\n  - {path: ü, is_on: yes}\nnothing:\n"
    sounds = [{"path": "a b", "start": 1.5}, {"path": "ü", "is_on": True}]
    assert read_yaml(text, "x") == {"kind": "pairwise", "sounds": sounds, "nothing": None}
    assert read_yaml("# nothing\n", "x") is None
    assert read_yaml("[" * 19 + "{a: b}" + "]" * 19, "x")


@pytest.mark.usefixtures("loader")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: [", "while parsing"),
        ("a: &b {c: *b}", "alias"),
        ("a: &a {k: v}\nb: &b {<<: [*a, *a]}\nc: {<<: [*b, *b]}", "alias"),
        ("a: !!python/object/apply:os.getcwd []", "tag"),
        ("a: !!int ''", "tag"),
        ("a: !own b", "tag"),
        ("[" * 60_000, "levels|depth"),
        ("- " * 30_000, "levels"),
        ("{a: " * 15_000, "levels|depth"),
        ("a: 2020-99-99", "month"),
        (f"a: {'9' * 5_000}", "digits"),
        ("a: \0", "not allowed"),
        ("a: \ud800", "not allowed"),
        ("a: b\n---\nc: d", "single document"),
        ("? [a]\n: b", "unhashable"),
    ],
)
def test_what_is_none_is_one_error_that_names_the_text_and_comes_at_once(text: str, said: str) -> None:
    def refused() -> None:
        with pytest.raises(EchoAvatarError, match=rf"^study\.yaml is not YAML: .*({said})"):
            read_yaml(text, "study.yaml")

    assert seconds(refused) < 1.5


@pytest.mark.skipif(not HAS_C, reason="PyYAML without libyaml")
def test_libyaml_reads_where_it_is_there() -> None:
    text = "".join(f"- {{path: sounds/{k}.wav, category: dance, start: {k}.5}}\n" for k in range(300))
    assert 2 * seconds(lambda: read_yaml(text, "x")) < seconds(lambda: yaml.safe_load(text))
