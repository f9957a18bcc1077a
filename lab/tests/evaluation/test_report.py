from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.clips import clip, folder
from tests.motion.kinematics.samples import swaying

from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.timing import CHUNK_SAMPLES
from echoavatar_lab.corpora.rehearsal.corpus import Plan, make_clip
from echoavatar_lab.data import MUSIC
from echoavatar_lab.evaluation.measures import UNITS, clip_statistics
from echoavatar_lab.evaluation.metrics.liveliness import STATISTICS
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
from echoavatar_lab.evaluation.motion_folder import Pair, ReadOptions, read_pairs
from echoavatar_lab.evaluation.report import (
    evaluate,
    liveliness_rows,
    read_embeddings,
    retrieval_rows,
    score,
    semantic_row,
    style_rows,
)
from echoavatar_lab.evaluation.takes import Sound

PROMISED = {
    "codes_mpjpe_body",
    "codes_mpjpe_hands",
    "codes_trans_loss",
    "codebook_use_min",
    "nll_speech",
    "nll_music",
    "timing_gain_speech",
    "fid",
    "ba_g_sharp",
    "leg_energy_music_over_speech",
    "silence_hand_speed_ratio",
    "ba_onset",
    "ba_beat",
    "stroke_contrast",
    "skate",
    "jerk",
    "hand_speed",
    "max_joint_speed",
    "recordings_skate",
    "recordings_ba_onset",
    "recordings_border_ratio",
}


def test_every_promised_score_is_there_and_the_truth_scores_as_truth(tiny_bundle: Path, voice: np.ndarray) -> None:
    """Three made clips and two recordings through a bundle of random weights."""
    clips = [make_clip(Plan(1.0, 47, Path("unused"), clip_seconds=20.0), index) for index in (0, 1, 2)]
    recordings = [Sound(name, kind, "", np.resize(voice, 72_000)) for name, kind in (("a", "speech"), ("b", "music"))]
    told: dict[str, int] = {}
    rows = evaluate(
        load_bundle(tiny_bundle),
        clips,
        recordings,
        extractor=load_shipped(),
        repeats=2,
        progress=lambda what, done, total: told.update({what: total}),
    )
    scores = {row.name: row for row in rows}
    assert len(scores) == len(rows)
    assert scores.keys() >= PROMISED
    chunks = sum(-(-len(clip.audio) // CHUNK_SAMPLES) for clip in clips)
    assert told == {"held-out clips": 2 * chunks, "measuring": 3, "recordings": 2 * -(-72_000 // CHUNK_SAMPLES)}
    assert abs(scores["nll_all"].value - np.log(8)) < 0.5  # random weights know nothing: ln K
    assert scores["ba_beat"].truth > scores["ba_beat"].truth_chance
    assert scores["skate"].truth < 1
    assert scores["leg_energy_music_over_speech"].truth > 4


def pairs(tmp_path: Path, made_size: float) -> list[Pair]:
    names = {"a": 0.4, "b": 0.5, "c": 0.6}
    truth = [clip(name, every_s=pace, kind=MUSIC if name == "c" else 1) for name, pace in names.items()]
    made = [clip(name, size=made_size) for name in names]
    where = folder(tmp_path / f"made{made_size}", made), folder(tmp_path / "true", truth)
    return read_pairs(*where, ReadOptions())


def test_the_truth_has_no_errors_and_scores_as_itself(tmp_path: Path) -> None:
    told: list[int] = []
    rows = {r.name: r for r in score(pairs(tmp_path, 0.3), load_shipped(), progress=lambda n, _: told.append(n))}
    assert told == [1, 2, 3]
    assert rows["fid"].value == pytest.approx(0, abs=1e-3)
    for name in ("mpjpe_body", "mpjpe_hands", "trans_loss"):
        assert rows[name].value == pytest.approx(0, abs=1e-3)
    for name in (*UNITS, "ba_g_sharp", "ba_d_sharp"):
        assert rows[name].value == pytest.approx(rows[name].truth)
    assert rows["ba_g_sharp"].chance == pytest.approx(rows["ba_g_sharp"].truth_chance)


def test_a_livelier_body_shows_in_every_row_it_should(tmp_path: Path) -> None:
    """Without sound only what motion alone tells; twice the swing is twice the diversity and jerk, roughly."""
    silent = [Pair(p.name, p.made, p.true, None, p.domain) for p in pairs(tmp_path, 0.15)]
    rows = {row.name: row for row in score(silent, load_shipped())}
    assert not any(name.startswith("ba_") for name in rows)
    assert rows["l1_diversity"].value < 0.7 * rows["l1_diversity"].truth
    assert rows["jerk"].value < 0.7 * rows["jerk"].truth
    assert rows["mpjpe_body"].value > 5
    assert rows["fid"].value > 1
    assert rows["fid"].interval.low <= rows["fid"].value <= rows["fid"].interval.high
    assert "fid" not in {row.name for row in score(silent, None)}


def test_nothing_and_too_little_are_named() -> None:
    with pytest.raises(MotionError, match="no clip"):
        score([], None)
    short = swaying(7)
    with pytest.raises(MotionError, match="clip x has 7 frames"):
        score([Pair("x", short, short, None, np.zeros(7, np.uint8))], None)


def embeddings(pairs: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    audio = random.normal(size=(pairs, 32))
    return audio, audio + noise * random.normal(size=audio.shape)


def test_a_gallery_of_300_stands_beside_all_where_there_are_more() -> None:
    rows = {row.name: row for row in retrieval_rows(*embeddings(400, 1.0))}
    assert len(rows) == 20
    assert rows["a2m_r1_300"].value >= rows["a2m_r1_all"].value
    assert rows["a2m_r1_all"].chance == pytest.approx(0.25)
    assert len(retrieval_rows(*embeddings(100, 1.0))) == 10


def test_pairs_that_belong_together_are_over_chance_and_others_are_not() -> None:
    audio, motion = embeddings(200, 0.5)
    right = {row.name: row for row in retrieval_rows(audio, motion)}
    wrong = {row.name: row for row in retrieval_rows(audio, np.roll(motion, 1, 0))}
    assert right["m2a_mrr_all"].excess_interval.low > 50
    assert right["m2a_medr_all"].interval.high < 3
    assert wrong["m2a_r10_all"].interval.low < wrong["m2a_r10_all"].chance < 10


def test_files_that_do_not_fit_are_named(tmp_path: Path) -> None:
    path = tmp_path / "pairs.npz"
    with pytest.raises(EchoAvatarError, match="does not exist"):
        read_embeddings(path)
    path.write_bytes(b"no")
    with pytest.raises(EchoAvatarError, match="holds no arrays"):
        read_embeddings(path)
    np.savez(path, audio=np.zeros((3, 2)), motion=np.zeros((4, 2)))
    with pytest.raises(EchoAvatarError, match="pairs, size"):
        read_embeddings(path)
    np.savez(path, audio=np.full((3, 2), np.nan), motion=np.zeros((3, 2)))
    with pytest.raises(EchoAvatarError, match="not finite"):
        read_embeddings(path)


def test_a_row_for_each_statistic_with_the_truth_beside() -> None:
    """Smaller swings: slower hands than the truth's."""
    pairs = [Pair(f"{n}", swaying(240, size=0.1), swaying(240), None, np.ones(240, int)) for n in range(2)]
    rows = {row.name: row for row in liveliness_rows(pairs)}
    assert list(rows) == list(STATISTICS)
    assert 0 < rows["hand_speed"].value < rows["hand_speed"].truth
    assert rows["hand_speed"].truth == pytest.approx(clip_statistics(swaying(240))[0])


def dance_pairs(size: float) -> list[Pair]:
    """Three clips of 11 s that sway by so much beside clips that sway by 0.3 and more."""
    found = []
    for n in range(3):
        true = clip(f"c{n}", 330, size=0.3 + 0.05 * n, kind=MUSIC)
        made = swaying(330, size=size + 0.05 * n)
        found.append(Pair(true.name, made, true.motion(made.skeleton), true.audio, true.domain))
    return found


def test_dances_like_the_truth_are_no_distance_away_and_others_are() -> None:
    near, far = ({row.name: row for row in score(dance_pairs(size), None)} for size in (0.3, 0.9))
    assert near["fid_k"].value == pytest.approx(0, abs=1e-6)
    assert far["fid_k"].value > 1
    assert far["fid_g"].value > near["fid_g"].value
    spoken = dance_pairs(0.3)
    for pair in spoken:
        pair.domain[:] = 1
    assert not {"fid_k", "fid_g"} & {row.name for row in score(spoken, None)}


def test_the_recall_of_meant_gestures_needs_labels(tmp_path: Path) -> None:
    pairs = dance_pairs(0.3)
    for pair in pairs[:2]:
        (tmp_path / f"{pair.name}.txt").write_text("iconic_r\t1\t2\t1\t0.5\tbig\n")
    row = semantic_row(pairs[:2], tmp_path)
    assert row.value == pytest.approx(row.truth)
    assert row.truth == pytest.approx(31 / 330 * 0.5 / 0.165)
    with pytest.raises(EchoAvatarError, match="c2.txt"):
        semantic_row(pairs, tmp_path)


def test_dances_of_their_musics_style_are_nearer_to_it() -> None:
    random = np.random.default_rng(0)
    styles = ["salsa", "waltz"] * 12
    middles = {"salsa": np.zeros(8), "waltz": np.full(8, 3.0)}
    sounds, motions = (np.stack([middles[s] + random.normal(0, 0.5, 8) for s in styles]) for _ in range(2))
    rows = {row.name: row for row in style_rows(sounds, motions, styles)}
    assert rows["style_ratio"].interval.low > 3
    assert rows["style_ratio"].value == pytest.approx(rows["style_inter"].value / rows["style_intra"].value)
    half = np.concatenate([motions[:12], np.roll(motions[12:], 1, axis=0)])  # half of the dances are of the other style
    mixed = {row.name: row for row in style_rows(sounds, half, styles)}
    assert mixed["style_ratio"].value == pytest.approx(1, abs=0.1)
    with pytest.raises(EchoAvatarError, match="two styles"):
        style_rows(sounds, motions, ["salsa"] * 24)
