"""Our metrics against numbers of the published code, computed once on synthetic input (tests/fixtures/golden).

Every entry of `expected.json` is named here; the last test says so.
"""

import json
from functools import lru_cache
from pathlib import Path

import librosa
import numpy as np
import pytest
from tests.golden import golden, metric_inputs

from echoavatar_lab.evaluation.metrics import beat_alignment, dance_features, distributions, positions, retrieval
from echoavatar_lab.evaluation.metrics.beat_alignment import (
    EMAGE_RATE_HZ,
    GESTURE_RULES,
    SMPLX_UPPER_BODY,
    TRIMMED_FRAMES,
    gesture_alignment,
    gesture_beat_frames,
    music_beats,
    speech_onsets,
)

EXACT = 1e-9  # relative
BETWEEN_VARIANTS = 1e-3  # the fixtures' tolerance for FID
SINGLE = 1e-6  # AIST++ was computed in single precision
Array = np.ndarray


@lru_cache
def expected() -> dict:
    return json.loads(golden("metrics/expected.json").read_text())


def sound(name: str) -> Array:
    return metric_inputs()[name].astype(np.float32) / 32768


def trimmed(audio: Array, frames: int = 0) -> Array:
    """Two seconds off at the start and at the end of the motion, as the published scripts cut."""
    off = TRIMMED_FRAMES * EMAGE_RATE_HZ // 30
    end = (frames - TRIMMED_FRAMES) * EMAGE_RATE_HZ // 30 if frames else len(audio) - off
    return audio[off:end]


def beats(form: str, motion: Array, window: tuple[int, int] | None = None) -> list[Array]:
    return gesture_beat_frames(motion, GESTURE_RULES[form], metric_inputs()["mean_vel_smplxflame_30"], window=window)


def score(form: str, motion: Array, onsets: list[float], window: tuple[int, int] | None = None) -> float:
    found = beats(form, motion, window)
    return gesture_alignment([found[j] / 30 for j in SMPLX_UPPER_BODY], np.array(onsets), form)


def near(ours: float, theirs: float, tolerance: float = EXACT) -> None:
    assert ours == pytest.approx(theirs, rel=tolerance)


WHOLE = (0, 600)


@pytest.mark.parametrize("entry", ["full_s", "echo_cut_60f_s"])
def test_onsets(entry: str) -> None:
    if librosa.__version__ != expected()["onsets"]["librosa"]:
        pytest.skip("another librosa")
    audio = sound("audio_i16")
    found = speech_onsets(audio if entry == "full_s" else trimmed(audio), EMAGE_RATE_HZ)
    np.testing.assert_allclose(found, expected()["onsets"][entry], rtol=EXACT)


@pytest.mark.parametrize("clip", ["a", "b"])
def test_onsets_of_the_evaluation_tools(clip: str) -> None:
    frames = len(metric_inputs()[f"motion_{clip}"])
    found = speech_onsets(trimmed(sound("audio_i16"), frames), EMAGE_RATE_HZ)
    np.testing.assert_allclose(found, expected()["bc_emage_evaltools"][f"onsets_{clip}"], rtol=EXACT)


def test_ba_g_of_emage_meco_and_echoavatar() -> None:
    theirs = expected()["bc_echo_meco_emage2024"]
    near(score("emage", metric_inputs()["motion_a"], expected()["onsets"]["echo_cut_60f_s"]), theirs["value"])


def test_ba_g_motion_beats_of_all_55_joints_with_the_index_quirk() -> None:
    theirs = expected()["bc_echo_meco_emage2024"]["motion_beats_idx_relative_to_t_start"]
    assert [own.tolist() for own in beats("emage", metric_inputs()["motion_a"])] == theirs


def test_ba_g_without_trimming() -> None:
    theirs = expected()["bc_echo_meco_emage2024"]
    motion = metric_inputs()["motion_a"]
    assert [own.tolist() for own in beats("emage", motion, WHOLE)] == theirs["motion_beats_no_trim"]
    near(score("emage", motion, expected()["onsets"]["full_s"], WHOLE), theirs["value_no_trim"])


def test_ba_g_of_motion_that_l1_diversity_overwrote() -> None:
    """The published scripts score beats after L1 diversity turned the positions into |p - mean|."""
    motion = metric_inputs()["motion_a"]
    rectified = np.abs(motion - motion.mean(0))
    theirs = expected()["bc_echo_meco_emage2024"]["value_after_inplace_l1div_bug"]
    near(score("emage", rectified, expected()["onsets"]["echo_cut_60f_s"]), theirs)


@pytest.mark.parametrize(("form", "entry"), [("emage", "bc_echo_meco_emage2024"), ("evaltools", "bc_emage_evaltools")])
def test_ba_g_of_a_statue_is_zero(form: str, entry: str) -> None:
    statue = np.repeat(metric_inputs()["motion_a"][:1], 600, 0)
    assert score(form, statue, expected()["onsets"]["echo_cut_60f_s"]) == expected()[entry]["static_motion"]


def test_ba_g_of_the_evaluation_tools() -> None:
    theirs = expected()["bc_emage_evaltools"]
    assert [own.tolist() for own in beats("evaltools", metric_inputs()["motion_a"])] == theirs["beats_a"]
    near(score("evaltools", metric_inputs()["motion_a"], theirs["onsets_a"]), theirs["clip_a"])
    near(
        score("evaltools", metric_inputs()["motion_a"], expected()["onsets"]["full_s"], WHOLE), theirs["clip_a_no_trim"]
    )


def test_ba_g_over_clips_is_weighted_by_what_was_left_of_them() -> None:
    theirs = expected()["bc_emage_evaltools"]
    clips = [metric_inputs()["motion_a"], metric_inputs()["motion_b"]]
    scores = [score("evaltools", clip, theirs[f"onsets_{k}"]) for k, clip in zip("ab", clips, strict=True)]
    weights = [len(clip) - 2 * TRIMMED_FRAMES for clip in clips]
    near(np.average(scores, weights=weights), theirs["clips_a_b_length_weighted"])


def test_ba_g_rules_are_those_of_the_fixtures() -> None:
    for form, entry in (("emage", "bc_echo_meco_emage2024"), ("evaltools", "bc_emage_evaltools")):
        theirs, ours = expected()[entry], GESTURE_RULES[form]
        assert (ours.threshold, ours.sigma_s, ours.order) == (theirs["threshold"], theirs["sigma"], theirs["order"])
    theirs = expected()["bc_echo_meco_emage2024"]
    assert tuple(theirs["joints"]) == SMPLX_UPPER_BODY
    assert (theirs["t_start"], theirs["t_end"]) == (TRIMMED_FRAMES, 600 - TRIMMED_FRAMES)


@pytest.mark.parametrize(("entry", "clips"), [("a", "a"), ("echo_meco_a_b", "ab"), ("evaltools_a_b", "ab")])
def test_l1_diversity(entry: str, clips: str) -> None:
    motions = [metric_inputs()[f"motion_{k}"] for k in clips]
    found = np.average([positions.l1_deviation(m) for m in motions], weights=[len(m) for m in motions])
    near(float(found), expected()["l1div"][entry])


FID_INPUTS = {"full_rank": ("feat_g", "feat_r"), "rank_deficient": ("feat_g_small", "feat_r_small")}


@pytest.mark.parametrize("rank", FID_INPUTS)
def test_fid_in_eigen_form(rank: str) -> None:
    made, true = (metric_inputs()[name] for name in FID_INPUTS[rank])
    ours = distributions.frechet_distance(made, true)
    near(ours, expected()["fid"][rank]["independent_eigh"], EXACT if rank == "full_rank" else 1e-8)
    for theirs in expected()["fid"][rank].values():
        assert ours == pytest.approx(theirs, rel=BETWEEN_VARIANTS)


@pytest.mark.parametrize("who", ["meco_echo", "bailando"])
@pytest.mark.parametrize("rank", FID_INPUTS)
def test_fid_of_meco_and_bailando(rank: str, who: str) -> None:
    theirs = next(value for key, value in expected()["fid"][rank].items() if key.startswith(who))
    made, true = (metric_inputs()[name] for name in FID_INPUTS[rank])
    near(distributions.frechet_distance(made, true), theirs, EXACT if rank == "full_rank" else 2e-8)


@pytest.mark.parametrize("rank", FID_INPUTS)
def test_fid_of_the_evaluation_tools(rank: str) -> None:
    """1e-6 on both diagonals, inside the root."""
    theirs = next(v for k, v in expected()["fid"][rank].items() if k.startswith("emage_evaltools"))
    made, true = (metric_inputs()[name] for name in FID_INPUTS[rank])
    ours = distributions.frechet_distance(made, true, ridge=1e-6)
    near(ours, theirs, 1e-8)


def test_fid_of_features_scaled_by_the_truth() -> None:
    made, true = distributions.scaled_by_truth(*(metric_inputs()[k].astype(np.float64) for k in ("feat_g", "feat_r")))
    near(distributions.frechet_distance(made, true), expected()["fid"]["bailando_z_normalised_by_gt(full_rank)"])


def test_foot_contact_score_of_edge() -> None:
    ours = positions.foot_contact_score(metric_inputs()["motion_a"][:, :24], (7, 10, 8, 11), up=2)
    near(ours, expected()["edge_pfc_motion_a_first24"], SINGLE)


DANCES = {60: lambda: metric_inputs()["motion_a24_60fps"], 30: lambda: metric_inputs()["motion_a"][:, :24]}


def dance(fps: int) -> dict:
    return expected()[f"ba_dance_{fps}fps"]


def test_music_beats() -> None:
    if librosa.__version__ != expected()["onsets"]["librosa"]:
        pytest.skip("another librosa")
    found = music_beats(sound("music_i16"), EMAGE_RATE_HZ, hop=512)
    np.testing.assert_allclose(found, expected()["ba_dance_beats"]["beat_times_s"], rtol=EXACT)
    near(60 / np.median(np.diff(found)), expected()["ba_dance_beats"]["tempo"], 0.01)
    for fps in DANCES:
        assert np.round(found * fps).astype(int).tolist() == dance(fps)["music_beats"]


@pytest.mark.parametrize("fps", DANCES)
@pytest.mark.parametrize(
    ("form", "entry"),
    [
        ("bailando", "bailando_motion_beats"),
        ("aist", "mint_motion_beats"),
        ("paper", "paper_formula_decel_peaks(frames)"),
    ],
)
def test_motion_beats_of_dance(form: str, entry: str, fps: int) -> None:
    assert beat_alignment.dance_beat_frames(DANCES[fps](), form).tolist() == dance(fps)[entry]


@pytest.mark.parametrize("fps", DANCES)
@pytest.mark.parametrize(
    ("form", "entry", "tolerance"), [("bailando", "bailando_BA", EXACT), ("aist", "mint_BA", SINGLE)]
)
def test_ba_d_of_bailando_and_aist(form: str, entry: str, tolerance: float, fps: int) -> None:
    motion = beat_alignment.dance_beats(DANCES[fps](), form, fps=fps)
    ours = beat_alignment.dance_alignment(motion, np.array(dance(fps)["music_beats"]) / fps, form, fps=fps)
    near(ours, dance(fps)[entry], tolerance)


@pytest.mark.parametrize(
    ("fps", "sigma"), [(60, "1"), (60, "3"), (60, "3.0"), (60, "6.0"), (30, "1"), (30, "1.5"), (30, "3"), (30, "3.0")]
)
def test_ba_d_by_the_papers_formula(fps: int, sigma: str) -> None:
    motion = beat_alignment.dance_beat_frames(DANCES[fps](), "paper")
    ours = beat_alignment.hit_rate(np.array(dance(fps)["music_beats"]), motion, float(sigma))
    near(ours, dance(fps)["paper_formula_BA_D"][f"sigma_{sigma}"])


def test_the_papers_form_is_its_formula_at_three_frames_of_sixty() -> None:
    motion = beat_alignment.dance_beats(DANCES[60](), "paper", fps=60)
    ours = beat_alignment.dance_alignment(motion, np.array(dance(60)["music_beats"]) / 60, "paper", fps=60)
    near(ours, dance(60)["paper_formula_BA_D"]["sigma_3"])


def test_kinetic_features_of_bailando() -> None:
    """It subtracts the first root, which its acceleration hears."""
    motion = metric_inputs()["motion_a"][:90, :24].astype(np.float64)
    theirs = np.array(expected()["bailando_kinetic_features_first24_a90"])
    assert dance_features.kinetic(motion - motion[:1, :1]) == pytest.approx(theirs, rel=5e-6)


def test_fid_of_features_that_the_truth_scales() -> None:
    inputs = metric_inputs()
    made, true = distributions.scaled_by_truth(*(inputs[name].astype(np.float64) for name in ("feat_g", "feat_r")))
    theirs = expected()["fid"]["bailando_z_normalised_by_gt(full_rank)"]
    near(distributions.frechet_distance(made, true), theirs, BETWEEN_VARIANTS)


@lru_cache
def similarity() -> Array:
    return retrieval.similarity(metric_inputs()["emb_audio"], metric_inputs()["emb_motion"])


@pytest.mark.parametrize("way", ["a2m", "m2a"])
def test_ranks_and_reciprocal_rank(way: str) -> None:
    matrix = similarity() if way == "a2m" else similarity().T
    theirs = expected()["retrieval"]
    assert retrieval.ranks(matrix).tolist() == theirs[f"ranks0_{way}"]
    mrr = theirs["MRR_a2m(ours,mean 1/(rank0+1))" if way == "a2m" else "MRR_m2a"]
    near(retrieval.retrieval(matrix).reciprocal_rank / 100, mrr)


@pytest.mark.parametrize("way", ["t2m", "m2t"])
@pytest.mark.parametrize("protocol", ["tmr_all", "tmr_guo_small_batches_32"])
def test_recall_and_median_rank_of_tmr(protocol: str, way: str) -> None:
    matrix = similarity() if way == "t2m" else similarity().T
    ours = retrieval.retrieval(matrix) if protocol == "tmr_all" else retrieval.batched(matrix)
    theirs = expected()["retrieval"][protocol]
    for k, value in ours.recall.items():
        near(value, theirs[f"{way}/R{k:02d}"])
    near(ours.median_rank, theirs[f"{way}/MedR"])
    assert ours.gallery == theirs[f"{way}/len"]


def test_batches_of_tmr() -> None:
    theirs = expected()["retrieval"]["guo_batches"]
    assert [batch.tolist() for batch in retrieval.tmr_batches(128)] == theirs


def test_hit_rate_is_what_all_of_them_share() -> None:
    assert beat_alignment.hit_rate(np.array([1.0]), np.array([1.3]), 0.3) == pytest.approx(np.exp(-0.5))


def test_no_entry_of_the_fixtures_is_left_out() -> None:
    """Each leaf's name occurs in this file, or a longer name that is built from it."""
    text = Path(__file__).read_text()
    notes = {"note", "params", "librosa", "fps", "clip", "similarity"}
    not_ours = ("bailando_div",)  # measures that we do not offer

    def leaves(node: object, path: tuple[str, ...]) -> list[tuple[str, ...]]:
        if isinstance(node, dict):
            return [leaf for key, value in node.items() for leaf in leaves(value, (*path, key))]
        return [path]

    built = ("onsets_", "ranks0_", "sigma_", "t2m/", "m2t/", "meco_echo", "emage_evaltools", "bailando(")
    for path in leaves(expected(), ()):
        name = path[-1]
        assert name in notes or name in text or name.startswith(built + not_ours), path
