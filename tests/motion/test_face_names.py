"""Faces of other programs, by the names that these write, move as our curves say; a curve moves a face once."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from tests.motion.foreign_faces import FACES

from echoavatar.motion.arkit import APPLE_NAMES, ARKIT_NAMES, to_vrm
from echoavatar.motion.face_names import driven, face_weights, read_name, silent_curves

ROOT = Path(__file__).parents[2]
AS_OURS = ("arkit", "maya", "live_link", "snake", "capitals", "joined", "hyphens", "blender", "numbered")
CURVES = np.random.default_rng(0).uniform(0, 0.8, (40, 52)).astype(np.float32)


def moved(kind: str, **curves: float) -> dict[str, float]:
    """The targets that move at these curves, and how far."""
    face = np.zeros((1, 52), np.float32)
    for name, weight in curves.items():
        face[0, ARKIT_NAMES.index(name)] = weight
    (weights,) = face_weights(driven(FACES[kind]), face)
    return {name: round(float(weight), 3) for name, weight in zip(FACES[kind], weights, strict=True) if weight}


@pytest.mark.parametrize("kind", AS_OURS)
def test_our_52_names_are_read_however_they_are_written(kind: str) -> None:
    wanted = CURVES[:, [ARKIT_NAMES.index(name) for name in APPLE_NAMES]]
    np.testing.assert_array_equal(face_weights(driven(FACES[kind]), CURVES), wanted)
    assert silent_curves(driven(FACES[kind])) == []


SIDES = {"eyeBlinkLeft": 0.4, "eyeBlinkRight": 0.4}


@pytest.mark.parametrize(
    ("kind", "curves", "wanted"),
    [
        ("vrm0", {"jawOpen": 0.5}, {"A": 0.8}),
        ("vrm1", {"jawOpen": 0.5}, {"aa": 0.8}),
        ("vrm1", SIDES, {"blinkLeft": 0.4, "blinkRight": 0.4}),
        ("vrm1", {"mouthSmileLeft": 0.5, "mouthSmileRight": 0.3}, {"happy": 0.4}),
        ("vrm1", {"eyeLookOutLeft": 0.5, "eyeLookInRight": 0.5}, {"lookLeft": 0.5}),
        ("vroid", {"jawOpen": 0.5}, {"Face.M_F00_000_00_Fcl_MTH_A": 0.8}),
        ("vroid", SIDES, {f"Face.M_F00_000_00_Fcl_EYE_Close_{side}": 0.4 for side in "LR"}),
        ("vroid", {"mouthSmileLeft": 0.4, "mouthSmileRight": 0.4}, {"Face.M_F00_000_00_Fcl_ALL_Joy": 0.4}),
        ("mmd", {"jawOpen": 0.5}, {"あ": 0.8}),
        ("mmd", SIDES, {"まばたき": 0.4}),
        ("oculus", {"jawOpen": 0.5}, {"aa": 0.8}),
        ("oculus", {"mouthPressLeft": 0.5, "mouthPressRight": 0.5}, {"PP": 0.5}),
        ("vrchat", {"eyeBlinkLeft": 0.4}, {"vrc.blink_left": 0.4}),
        ("ready_player_me", {"jawOpen": 0.5}, {"viseme_aa": 0.8}),
        ("ready_player_me", SIDES, {"eyeBlinkLeft": 0.4, "eyeBlinkRight": 0.4}),
        ("reallusion", {"jawOpen": 0.5}, {"Jaw_Open": 0.5}),
        ("reallusion", {"eyeLookOutLeft": 0.5}, {"Eye_L_Look_L": 0.5}),
        ("reallusion", {"jawLeft": 0.5, "mouthRight": 0.25}, {"Jaw_L": 0.5, "Mouth_R": 0.25}),
        (
            "reallusion",
            {"mouthFunnel": 0.5},
            {f"Mouth_Funnel_{part}": 0.5 for part in ("Up_L", "Up_R", "Down_L", "Down_R")},
        ),
        ("metahuman", {"jawOpen": 0.5}, {"CTRL_expressions_jawOpen": 0.5}),
        ("metahuman", {"eyeLookInRight": 0.5}, {"CTRL_expressions_eyeLookLeftR": 0.5}),
        ("metahuman", {"mouthSmileLeft": 0.5}, {"CTRL_expressions_mouthCornerPullL": 0.5}),
        ("metahuman", {"browInnerUp": 0.5}, {f"CTRL_expressions_browRaiseIn{side}": 0.5 for side in "LR"}),
        ("facs", {"jawOpen": 0.5, "browDownLeft": 0.4}, {"AU04": 0.2, "AU26_JawDrop": 0.5}),
        ("facs", {"mouthFrownLeft": 0.5}, {"AU15_LipCornerDepressor": 0.25}),
        ("daz", {"jawOpen": 0.5, "mouthFunnel": 0.25}, {"facs_jnt_JawOpen": 0.5, "facs_bs_MouthFunnel_div2": 0.25}),
        ("daz", {"mouthSmileLeft": 0.5}, {"facs_bs_MouthSmileLeft_div2": 0.5}),
        ("daz_visemes", {"jawOpen": 0.5}, {"Genesis8Female__eCTRLvAA": 0.8}),
        ("meta", {"jawOpen": 0.5}, {"jawDrop": 0.5}),
        ("meta", {"mouthShrugLower": 0.5, "mouthShrugUpper": 0.25}, {"chinRaiserB": 0.5, "chinRaiserT": 0.25}),
        ("meta", {"eyeSquintLeft": 0.5, "browDownRight": 0.25}, {"lidTightenerL": 0.5, "browLowererR": 0.25}),
        ("mb_lab", {"jawOpen": 0.5}, {"Expressions_mouthOpen_max": 0.5}),
        ("mb_lab", {"eyeBlinkLeft": 0.4}, {"Expressions_eyeClosedL_max": 0.4}),
        ("sranipal", {"eyeSquintLeft": 0.5}, {"Eye_Left_Squeeze": 0.5}),
        ("unified", {"mouthShrugLower": 0.5}, {"MouthRaiserLower": 0.5}),
        ("faceshift", {"browInnerUp": 0.5, "browOuterUpLeft": 0.25}, {"BrowsU_C": 0.5, "BrowsU_L": 0.25}),
        ("faceshift", {"eyeLookInLeft": 0.5, "eyeWideLeft": 0.25}, {"EyeIn_L": 0.5, "EyeOpen_L": 0.25}),
        ("faceshift", {"mouthShrugUpper": 0.5, "cheekPuff": 0.25}, {"ChinUpperRaise": 0.5, "Puff": 0.25}),
        ("fuse", {"mouthPucker": 0.5}, {"MouthNarrow_Left": 0.5, "MouthNarrow_Right": 0.5}),
        ("fuse", {"mouthRollLower": 0.5, "jawForward": 0.25}, {"LowerLipIn": 0.5, "JawForeward": 0.25}),
        ("make_human", {"eyeBlinkLeft": 0.5, "mouthLeft": 0.25}, {"LeftUpperLidClosed": 0.5, "MouthMoveLeft": 0.25}),
        ("make_human", {"mouthSmileRight": 0.5}, {"MouthRightPullUp": 0.5}),
        ("sides_of_maya", {"eyeBlinkLeft": 0.5, "eyeBlinkRight": 0.25}, {"lf_eyeBlink": 0.5, "rt_eyeBlink": 0.25}),
        ("sides_of_maya", {"mouthSmileLeft": 0.5}, {"smile_lf": 0.5}),
        ("vowels_of_lips", {"jawOpen": 0.5}, {"mouth_AA": 0.8}),
    ],
)
def test_a_face_of_another_program_does_what_ours_does(
    kind: str, curves: dict[str, float], wanted: dict[str, float]
) -> None:
    assert moved(kind, **curves) == pytest.approx(wanted)


@pytest.mark.parametrize("kind", FACES)
def test_no_face_is_moved_past_its_shapes(kind: str) -> None:
    shares = driven(FACES[kind])
    weights = face_weights(shares, CURVES)
    assert weights.min() >= 0
    assert weights.max() <= 1
    presets = shares[len(ARKIT_NAMES) :].any(0)
    assert weights[:, presets].sum(1).max(initial=0) <= 1 + 1e-6
    assert not face_weights(shares, np.zeros((1, 52), np.float32)).any()


def test_a_vowel_that_is_missing_is_said_by_its_neighbour() -> None:
    wide = np.zeros((1, 52), np.float32)
    for name, weight in {"jawOpen": 0.5, "mouthStretchLeft": 0.5, "mouthStretchRight": 0.5}.items():
        wide[0, ARKIT_NAMES.index(name)] = weight
    vowels = to_vrm(wide)[0, :5]
    (aa,) = face_weights(driven(["aa"]), wide)[0]
    assert aa == pytest.approx(vowels[0] + vowels[1] + vowels[3], abs=1e-6)
    assert face_weights(driven(["mouthOpen"]), wide) == pytest.approx(0.5)


def test_names_of_anything_else_say_nothing() -> None:
    assert [name for name in FACES["strangers"] if read_name(name)] == []
    assert not driven(FACES["strangers"]).any()
    assert len(silent_curves(driven([]))) == 52


def test_the_pages_read_names_by_the_same_tables() -> None:
    """After a change of face_names.py: python -m scripts.make_face_names && make web."""
    made = runpy.run_path(str(ROOT / "scripts" / "make_face_names.py"))
    assert made["TARGET"].read_text("utf-8") == made["text"]()
    assert made["CASES"].read_text("utf-8") == made["cases"]()
