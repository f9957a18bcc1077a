"""From settings to an open study; and what fails says why."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import soundfile
from studio.tests import canned

from echoavatar.errors import AudioError, EchoAvatarError
from echoavatar.motion.formats.tables import read_npz, write_npz
from echoavatar_studio import making
from echoavatar_studio.clips import load_clip
from echoavatar_studio.making import Maker
from echoavatar_studio.run import mark_broken
from echoavatar_studio.settings import PairwiseStudy, parse_study
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


def made(maker: Maker, library, **changes) -> tuple[PairwiseStudy, list[making.Material], Path]:
    settings = parse_study(canned.pairwise_text(**changes))
    folder = maker.media / "made"
    return settings, making.make_pairwise(settings, library, folder, lambda *_: None), folder


def test_mismatched_motion_is_the_systems_own_to_another_sound(maker: Maker, library):
    systems = [
        {"name": "Alpha", "clips": "Alpha", "group": "A"},
        {"name": "Alpha elsewhere", "mismatched": "Alpha", "group": "A"},
    ]
    _, rows, folder = made(maker, library, systems=systems)
    by_name = {row.name: {key: folder / file for key, file, *_ in row.clips} for row in rows}
    for kind in ("music", "speech"):
        for own, other in ((0, 1), (1, 0)):
            here, there = by_name[f"{kind} {own}"], by_name[f"{kind} {other}"]
            assert here["Alpha elsewhere"].read_bytes() == there["Alpha"].read_bytes() != here["Alpha"].read_bytes()
    with pytest.raises(AudioError, match="only sound of dance"):
        made(maker, library, systems=systems, sounds=[{"path": "music/music 0.flac", "category": "dance"}])


def test_a_muted_study_is_silent_and_does_not_ask_about_the_sound(maker: Maker, library):
    _, rows, folder = made(maker, library, muted=True, questions=["human_likeness"])
    assert all(not soundfile.read(folder / row.sound)[0].any() for row in rows)
    _, rows, folder = made(maker, library)
    assert all(soundfile.read(folder / row.sound)[0].any() for row in rows)
    with pytest.raises(EchoAvatarError, match="muted study cannot ask beat_matching"):
        parse_study(canned.pairwise_text(muted=True))


def test_one_system_without_a_face_makes_all_faces_neutral(maker: Maker, library, tmp_path):
    base = tmp_path / "faces"
    shutil.copytree(library, base)
    for path in (base / "Alpha").glob("*.npz"):
        motion = read_npz(path)
        write_npz(path, motion, face=np.full((motion.frames, 52), 0.5, np.float32))
    alone = [{"name": name, "clips": "Alpha", "group": "A"} for name in ("Alpha", "Twin")]
    _, rows, folder = made(maker, base, systems=alone)
    assert all(load_clip(folder / file).face is not None for row in rows for _, file, *_ in row.clips)
    _, rows, folder = made(maker, base)  # Beta has none
    shown = [load_clip(folder / file).face for row in rows for _, file, *_ in row.clips]
    shown += [load_clip(folder / row.corrupted).face for row in rows]
    assert all(face is None or not np.any(face) for face in shown)


def test_a_mismatch_is_of_a_system_of_its_group():
    for wrong in ("Gamma", "nobody"):
        systems = [
            {"name": "Alpha", "clips": "Alpha", "group": "A"},
            {"name": "Other", "mismatched": wrong, "group": "A"},
            {"name": "Gamma", "clips": "Gamma", "group": "B"},
            {"name": "Beta", "clips": "Beta", "group": "B"},
        ]
        with pytest.raises(EchoAvatarError, match=f"mismatched is '{wrong}'"):
            parse_study(canned.pairwise_text(systems=systems))
