"""Motorica Dance Dataset: six hours of dance in eight styles, `bvh/` at 120 fps and `wav/` of the same names.

Parts of it come with Listen, Denoise, Action! as `NAME_00.expmap_30fps.pkl`, without fingers (`lda`). They are taken
for dances of which there is no BVH. Mirrored ones are left out: sets mirror by themselves.

Names follow AIST: prefix_genre_situation_camera_dancer_music_choreography. Music of the casual session (`kthmisc`) is
not published, so these clips have no sound. The data comes without a split; published work on it holds out the ten test
clips below. In many clips fingers are missing or drift, which is the reason for the paper's motion refinement.
"""

import re
from pathlib import Path

from .lda import SUFFIX
from .source import LeftOut, Recording, Survey, Terms, files_below

TERMS = Terms(
    title="Motorica Dance Dataset",
    origin="https://github.com/simonalexanderson/MotoricaDanceDataset",
    licence="own terms: non-commercial research use, no redistribution; the music belongs to its own holders",
    may_ship="nothing: neither the files, nor this set, nor weights trained on it for commercial use",
    cite="Alexanderson, Nagy, Beskow, Henter: Listen, Denoise, Action! Audio-Driven Motion Synthesis with Diffusion "
    "Models. ACM TOG 42(4), 2023; Valle-Perez, Henter, Beskow, Holzapfel, Oudeyer, Alexanderson: Transflower. ACM TOG "
    "40(6), 2021",
)
RATES = (120.0, 60.0, 30.0)  # published, the retargeted copies in use, and those of LDA
GENRES = {
    "gLH": "hiphop",
    "gKR": "krumping",
    "gPO": "popping",
    "gLO": "locking",
    "gJZ": "jazz",
    "gCH": "charleston",
    "gTP": "tapping",
    "gCA": "casual",
}
TEST = (
    "kthjazz_gCH_sFM_cAll_d02_mCH_ch01_whitemanpaulandhisorchestraloisiana_006",
    "kthjazz_gJZ_sFM_cAll_d02_mJZ_ch01_bennygoodmansugarfootstomp_003",
    "kthjazz_gTP_sFM_sngl_d02_015",
    "kthmisc_gCA_sFM_cAll_d01_mCA_ch24",
    "kthstreet_gKR_sFM_cAll_d01_mKR_ch01_chargedcableupyour_001",
    "kthstreet_gLH_sFM_cAll_d01_mLH_ch01_thisisit_001",
    "kthstreet_gLH_sFM_cAll_d02_mLH_ch01_lala_001",
    "kthstreet_gLO_sFM_cAll_d02_mLO_ch01_arethafranklinrocksteady_002",
    "kthstreet_gPO_sFM_cAll_d01_mPO_ch01_bombom_002",
    "kthstreet_gPO_sFM_cAll_d02_mPO_ch01_bombom_001",
)
_NAME = re.compile(r"kth[a-z]+_(g[A-Z]{2})_s\w+?_(?:cAll|sngl)_(d\d+)")


def survey(folder: Path) -> Survey:
    """Find every dance by its name; its music is the wav of that name, in `wav/` beside `bvh/` or beside it."""
    recordings: list[Recording] = []
    left_out: list[LeftOut] = []
    sounds = {path.stem: path for path in files_below(folder, ".wav")}
    rig = next((path for path in files_below(folder, ".bvh") if _NAME.match(path.stem)), None)
    whole = {path.stem for path in files_below(folder, ".bvh")}
    for path in files_below(folder, ".bvh", ".pkl"):
        if path.suffix == ".pkl" and not path.name.endswith(SUFFIX):
            continue  # sound as LDA's features
        name = path.name.removesuffix(SUFFIX) if path.suffix == ".pkl" else path.stem
        match = _NAME.match(name)
        if not match:
            left_out.append(LeftOut(name, "its name is not one of Motorica; prepare it with `data prepare bvh`"))
            continue
        if path.suffix == ".pkl" and (name.endswith("_mirrored") or name in whole or name.rpartition("_")[0] in whole):
            left_out.append(LeftOut(name, "it is mirrored, or there is a BVH of the dance"))
            continue
        beside = path.parent.parent / "wav" if path.parent.name == "bvh" else path.parent
        recordings.append(
            Recording(
                name=name,
                motion=path,
                sound=sounds.get(name, beside / f"{name}.wav"),
                domain="music",
                split="test" if any(held in name for held in TEST) else "train",
                labels={"genre": GENRES.get(match[1], match[1]), "speaker": match[2]},
                rates=RATES,
                rig=rig if path.suffix == ".pkl" else None,
            )
        )
    there = {recording.labels["genre"] for recording in recordings}
    gone = [genre for genre in GENRES.values() if genre not in there]
    missing = [f"no clip of {', '.join(gone)}"] if gone else []
    return Survey(TERMS, recordings, missing, left_out, "ten test clips held out by published work on the set")
