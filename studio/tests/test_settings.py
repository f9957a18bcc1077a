"""study.yaml: what is taken, and what is refused by name."""

import pytest
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
