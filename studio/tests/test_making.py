"""From settings to an open study; and what fails says why."""

import pytest
from studio.tests import canned

from echoavatar.errors import EchoAvatarError
from echoavatar_studio.making import Maker
from echoavatar_studio.run import mark_broken
from echoavatar_studio.settings import parse_study
from echoavatar_studio.tables import Clip, Sound, Study, System, Task, Trial


def test_a_pairwise_study_has_a_clip_of_each_system_for_each_sound(maker: Maker, library):
    public = canned.make_pairwise(maker, library)
    with maker.store.read() as session:
        study = session.query(Study).one()
        assert (study.public, study.state) == (public, "open")
        assert [system.name for system in session.query(System).order_by(System.place)] == list(canned.SYSTEMS)
        sounds = session.query(Sound).all()
        assert sorted(sound.category for sound in sounds) == ["dance", "dance", "gesture", "gesture"]
        assert session.query(Clip).filter(Clip.system_id.is_not(None)).count() == 12
        assert session.query(Clip).filter(Clip.system_id.is_(None)).count() == 4
        for clip in session.query(Clip):
            assert (maker.media / clip.path).is_file()
        roles = [trial.role for trial in session.query(Trial)]
        assert [roles.count(role) for role in ("real", "identical", "corrupted", "training")] == [12, 4, 4, 4]
        assert session.query(Task).count() == 6 * 9


def test_progress_is_told_and_ends(maker: Maker, library):
    told, settings = [], parse_study(canned.pairwise_text())
    public = maker.begin(settings, by="test")
    maker.make(public, settings, library, progress=lambda done, of, what: told.append((done, of)))
    assert told[0] == (0, 1)
    assert told[-1] == (12, 12)
    assert maker.making == {}


def test_a_study_that_cannot_be_made_says_why_and_leaves_no_files(maker: Maker, library):
    settings = parse_study(canned.pairwise_text(seconds=30))
    public = maker.begin(settings, by="test")
    with pytest.raises(EchoAvatarError, match="the study shows 30 s"):
        maker.make(public, settings, library)
    with maker.store.read() as session:
        study = session.query(Study).one()
        assert study.state == "failed"
        assert "the study shows 30 s" in study.problem
    assert not (maker.media / public).exists()


def test_the_same_settings_are_known_again(maker: Maker, library):
    public = canned.make_pairwise(maker, library)
    assert maker.known(parse_study(canned.pairwise_text())) == public
    assert maker.known(parse_study(canned.pairwise_text(raters=7))) is None


def test_making_that_was_cut_off_is_marked(maker: Maker):
    maker.begin(parse_study(canned.pairwise_text()), by="test")
    mark_broken(maker.store)
    with maker.store.read() as session:
        assert session.query(Study).one().state == "failed"
