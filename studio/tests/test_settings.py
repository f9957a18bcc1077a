"""study.yaml: what is taken, and what is refused by name."""

import time

import pytest
import yaml
from studio.tests import canned

from echoavatar.errors import EchoAvatarError
from echoavatar_studio.settings import PAIRWISE_TEMPLATE, PREFERENCE_TEMPLATE, parse_study, read_study


def test_templates_are_studies():
    assert parse_study(PAIRWISE_TEMPLATE).kind == "pairwise"
    study = parse_study(PREFERENCE_TEMPLATE)
    assert (study.kind, study.candidates, study.keep.votes) == ("preference", 8, 3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "other"}, "kind"),
        ({"raters": 0}, "raters: Input should be greater than or equal to 1"),
        ({"unknown": 1}, "unknown: Extra inputs are not permitted"),
        ({"systems": [{"name": "A", "clips": "a"}]}, "systems: Tuple should have at least 2 items"),
        ({"systems": [{"name": "A", "clips": "a"}, {"name": "A", "clips": "b"}]}, "the same name"),
        ({"systems": [{"name": "A"}, {"name": "B", "clips": "b"}]}, "needs one of model, clips"),
        ({"systems": [{"name": n, "clips": n, "group": n[:1]} for n in ("a1", "a2", "b1")]}, "group 'b' has one"),
        ({"questions": ["overall_preference"] * 2}, "asked twice"),
    ],
)
def test_what_is_wrong_is_named(changes, message):
    with pytest.raises(EchoAvatarError, match=message):
        parse_study(canned.pairwise_text(**changes))


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML without libyaml")
def test_a_study_of_many_sounds_is_read_faster_than_in_python():
    sounds = [{"path": f"sounds/{k}.wav", "category": "dance", "start": k + 0.5} for k in range(300)]
    text = canned.pairwise_text(sounds=sounds)
    took = []
    for parse in (parse_study, yaml.safe_load):
        began = time.thread_time()
        parse(text)
        took.append(time.thread_time() - began)
    assert 2 * took[0] < took[1]


def test_settings_have_no_aliases_whose_copies_would_fill_the_memory():
    rows = ["a: &a {kind: pairwise}", *(f"{b}: &{b} {{<<: [{', '.join(9 * ['*' + a])}]}}" for a, b in ("ab", "bc"))]
    with pytest.raises(EchoAvatarError, match="alias"):
        parse_study("\n".join(rows))


@pytest.mark.parametrize("text", ["", "- 1", "a: [", "!!python/object/apply:os.system ['true']", "kind: pairwise"])
def test_no_study_at_all(text):
    with pytest.raises(EchoAvatarError, match=r"study\.yaml"):
        parse_study(text)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(EchoAvatarError, match="cannot be read"):
        read_study(tmp_path / "none.yaml")
    (tmp_path / "study.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(EchoAvatarError, match="cannot be read"):
        read_study(tmp_path / "study.yaml")
