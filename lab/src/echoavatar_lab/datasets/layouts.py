"""Published datasets, and folders of BVH: finds recordings, splits and terms of use in the user's own copy.

Each layout has its `Terms` and a function from folder to `Survey`; `LAYOUTS` names them as the command line does.
docs/datasets.md says what a copy must hold. Beyond that:

- ZeroEGGS: `clean/` is aligned and read, `original/` is not. `ZEROEGGS_VALIDATION` repeats the split of `info.csv` for
  copies without that file. Retargeted copies that keep the names are read the same way.
- Motorica: names follow AIST (prefix_genre_situation_camera_dancer_music_choreography). Music of the casual session
  (`kthmisc`) is not published. Published work holds out `MOTORICA_TEST`. Parts come with Listen, Denoise, Action! as
  `NAME_00.expmap_30fps.pkl`, without fingers (`lda`); they stand for dances of which there is no BVH. Mirrored ones are
  left out: sets mirror by themselves.
- BEAT2: an id begins with the speaker's number and name, as in 2_scott_0_1_1. Types are train, val, test, additional.
- Bandai-Namco: dataset-{n}_{content}_{style}_{id}. The rig has 22 joints, no fingers and an unusual rest pose.
"""

import fnmatch
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio.files import sound_named
from echoavatar_lab.foreign.csv_rows import read_rows

from .lda import SUFFIX
from .source import Domain, LeftOut, Recording, Survey, Terms, files_below

ZEROEGGS = Terms(
    title="ZeroEGGS (ZEGGS), Ubisoft La Forge",
    origin="https://github.com/ubisoft/ubisoft-laforge-ZeroEGGS",
    licence="CC BY-NC-ND 4.0",
    may_ship="nothing: neither the files, nor this set, nor weights trained on it for commercial use",
    cite="Ghorbani, Ferstl, Holden, Troje, Carbonneau: ZeroEGGS: Zero-shot Example-based Gesture Generation from "
    "Speech. Computer Graphics Forum 42(1), 2023",
)
ZEROEGGS_RATES = (60.0, 30.0)  # published, and the 30 fps copies in use
ZEROEGGS_RECORDINGS = 67
ZEROEGGS_VALIDATION = (5, 10, 15, 20, 25, 29, 33, 35, 38, 41, 44, 47, 50, 53, 56, 58, 61, 64, 65, 66, 67)
_ZEROEGGS_NAME = re.compile(r"(\d{3})_([A-Za-z]+)_(\d+)")


def zeroeggs(folder: Path) -> Survey:
    """Find every BVH named like a recording; its sound has the same name and lies beside it."""
    recordings: list[Recording] = []
    left_out: list[LeftOut] = []
    official = _validation(folder)
    for path in files_below(folder, ".bvh"):
        match = _ZEROEGGS_NAME.match(path.stem)
        if not match:
            left_out.append(LeftOut(path.stem, "its name is not one of ZeroEGGS; prepare it with `data prepare bvh`"))
        elif "original" in path.relative_to(folder).parts:
            left_out.append(LeftOut(f"original/{path.stem}", "not aligned with its sound; clean/ is read"))
        elif "mirror" in path.stem:
            left_out.append(LeftOut(path.stem, "a mirror image; the set has its own"))
        else:
            number, style = int(match[1]), match[2]
            held_out = official.get(match[0], number in ZEROEGGS_VALIDATION)
            recordings.append(
                Recording(
                    name=path.stem,
                    motion=path,
                    sound=path.with_suffix(".wav"),
                    domain="speech",
                    split="test" if held_out else "train",
                    labels={"style": style, "speaker": "1"},
                    rates=ZEROEGGS_RATES,
                )
            )
    numbers = {int(recording.name[:3]) for recording in recordings}
    gone = [number for number in range(1, ZEROEGGS_RECORDINGS + 1) if number not in numbers]
    missing = [f"{len(gone)} of {ZEROEGGS_RECORDINGS} recordings: {_spans(gone)}"] if gone else []
    source = "validation column of info.csv" if official else "published validation list, by number"
    return Survey(ZEROEGGS, recordings, missing, left_out, source)


def _validation(folder: Path) -> Mapping[str, bool]:
    """Map each recording (as in 001_Neutral_0) to whether it is held out; empty without info.csv."""
    table = next((p for p in (*files_below(folder, ".csv"), folder.parent / "info.csv") if p.name == "info.csv"), None)
    if table is None or not table.is_file():
        return {}
    return {
        Path(row["anim_bvh"]).stem: row["validation"].strip().upper() == "TRUE"
        for row in read_rows(table)
        if row.get("anim_bvh") and row.get("validation")
    }


def _spans(numbers: list[int]) -> str:
    """Numbers as ranges, as in "001-004, 007"."""
    spans: list[list[int]] = []
    for number in numbers:
        if spans and spans[-1][-1] == number - 1:
            spans[-1] = [spans[-1][0], number]
        else:
            spans.append([number])
    return ", ".join("-".join(f"{n:03d}" for n in span) for span in spans)


MOTORICA = Terms(
    title="Motorica Dance Dataset",
    origin="https://github.com/simonalexanderson/MotoricaDanceDataset",
    licence="own terms: non-commercial research use, no redistribution; the music belongs to its own holders",
    may_ship="nothing: neither the files, nor this set, nor weights trained on it for commercial use",
    cite="Alexanderson, Nagy, Beskow, Henter: Listen, Denoise, Action! Audio-Driven Motion Synthesis with Diffusion "
    "Models. ACM TOG 42(4), 2023; Valle-Perez, Henter, Beskow, Holzapfel, Oudeyer, Alexanderson: Transflower. ACM TOG "
    "40(6), 2021",
)
MOTORICA_RATES = (120.0, 60.0, 30.0)  # published, the retargeted copies in use, and those of LDA
MOTORICA_GENRES = {
    "gLH": "hiphop",
    "gKR": "krumping",
    "gPO": "popping",
    "gLO": "locking",
    "gJZ": "jazz",
    "gCH": "charleston",
    "gTP": "tapping",
    "gCA": "casual",
}
MOTORICA_TEST = (
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
_MOTORICA_NAME = re.compile(r"kth[a-z]+_(g[A-Z]{2})_s\w+?_(?:cAll|sngl)_(d\d+)")


def motorica(folder: Path) -> Survey:
    """Find every dance by its name; its music is the wav of that name, in `wav/` beside `bvh/` or beside it."""
    recordings: list[Recording] = []
    left_out: list[LeftOut] = []
    sounds = {path.stem: path for path in files_below(folder, ".wav")}
    whole = {path.stem: path for path in files_below(folder, ".bvh")}
    rig = next((path for name, path in whole.items() if _MOTORICA_NAME.match(name)), None)
    for path in files_below(folder, ".bvh", ".pkl"):
        if path.suffix == ".pkl" and not path.name.endswith(SUFFIX):
            continue  # sound as LDA's features
        name = path.name.removesuffix(SUFFIX) if path.suffix == ".pkl" else path.stem
        match = _MOTORICA_NAME.match(name)
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
                split="test" if any(held in name for held in MOTORICA_TEST) else "train",
                labels={"genre": MOTORICA_GENRES.get(match[1], match[1]), "speaker": match[2]},
                rates=MOTORICA_RATES,
                rig=rig if path.suffix == ".pkl" else None,
            )
        )
    there = {recording.labels["genre"] for recording in recordings}
    gone = [genre for genre in MOTORICA_GENRES.values() if genre not in there]
    missing = [f"no clip of {', '.join(gone)}"] if gone else []
    return Survey(MOTORICA, recordings, missing, left_out, "ten test clips held out by published work on the set")


BEAT2 = Terms(
    title="BEAT2 (BEAT-SMPLX-FLAME)",
    origin="https://huggingface.co/datasets/H-Liu1997/BEAT2",
    licence="the dataset's card says Apache-2.0, its authors' repository CC BY-NC 4.0 for the motion capture; the"
    " SMPL-X body model has a non-commercial licence of its own",
    may_ship="the project treats it as non-commercial and ships neither the set nor weights trained on it",
    cite="Liu et al.: EMAGE: Towards Unified Holistic Co-Speech Gesture Generation via Expressive Masked Audio Gesture "
    "Modeling. CVPR 2024",
)
BEAT2_RATES = (30.0,)
BEAT2_SPLIT = "train_test_split.csv"


def beat2(folder: Path, *, has_additional: bool = False) -> Survey:
    """Find the recordings of every language folder below `folder`, by npz file and split table."""
    tables = [path for path in files_below(folder, ".csv") if path.name == BEAT2_SPLIT]
    places = [path.parent for path in tables] or sorted(
        {path.parent.parent for path in files_below(folder, ".npz") if path.parent.name == "smplxflame_30"}
    )
    if not places:
        raise EchoAvatarError(
            f"{folder} holds no {BEAT2_SPLIT} and no smplxflame_30/*.npz; name the folder beat_english_v2.0.0 or one"
            " above"
        )
    recordings: list[Recording] = []
    left_out: list[LeftOut] = []
    missing: list[str] = []
    for place in places:
        official = _beat2_split(place / BEAT2_SPLIT)
        if not official:
            missing.append(f"{place.name}/{BEAT2_SPLIT}: no official split")
        there = {path.stem: path for path in files_below(place, ".npz") if path.parent.name == "smplxflame_30"}
        gone = [name for name, kind in official.items() if name not in there and kind != "additional"]
        if gone:
            missing.append(
                f"{len(gone)} recordings of {place.name}/{BEAT2_SPLIT} without npz: {', '.join(gone[:3])}"
                + (", ..." if len(gone) > 3 else "")
            )
        for name, path in sorted(there.items()):
            kind = official.get(name, "")
            if official and not kind:
                left_out.append(LeftOut(name, f"not in {BEAT2_SPLIT}"))
            elif kind == "additional" and not has_additional:
                left_out.append(LeftOut(name, "additional data; pass --additional to use it"))
            else:
                recordings.append(_beat2_recording(name, path, place, "train" if kind == "additional" else kind))
    return Survey(BEAT2, recordings, missing, left_out, f"{BEAT2_SPLIT}, by recording of each speaker")


def _beat2_recording(name: str, path: Path, place: Path, split: str) -> Recording:
    words = name.split("_")
    labels = {"speaker": words[0], "speaker_name": words[1]} if len(words) > 1 else {}
    labels["language"] = place.name.removeprefix("beat_").partition("_")[0]
    return Recording(name, path, place / "wave16k" / f"{name}.wav", "speech", split, labels, BEAT2_RATES)


def _beat2_split(path: Path) -> Mapping[str, str]:
    """Map each recording to train, val, test or additional; empty without a table."""
    if not path.is_file():
        return {}
    rows = [(row.get("id", ""), row.get("type", "").strip().lower()) for row in read_rows(path)]
    strange = sorted({kind for _, kind in rows} - {"train", "val", "test", "additional"})
    if strange or not rows:
        raise EchoAvatarError(
            f"{path}: expected columns id and type with train, val, test or additional, found"
            f" {', '.join(map(repr, strange)) or 'no rows'}; fetch it again"
        )
    return dict(rows)


BANDAI = Terms(
    title="Bandai-Namco-Research-Motiondataset",
    origin="https://github.com/BandaiNamcoResearchInc/Bandai-Namco-Research-Motiondataset",
    licence="CC BY-NC 4.0",
    may_ship="with credit and for non-commercial use only; the project ships neither the set nor weights trained on it",
    cite="Kobayashi, Liao, Inoue, Yojima, Takahashi: Motion Capture Dataset for Practical Use of AI-based Motion "
    "Editing and Stylization, 2023",
)
BANDAI_RATES = (30.0,)
_BANDAI_NAME = re.compile(r"(dataset-[12])_(.+)_([a-z-]+)_(\d+)$")


def bandai(folder: Path) -> Survey:
    """Find every BVH whose name follows the dataset's pattern."""
    recordings: list[Recording] = []
    left_out: list[LeftOut] = []
    for path in files_below(folder, ".bvh"):
        match = _BANDAI_NAME.match(path.stem)
        if match:
            labels = {"part": match[1], "content": match[2], "style": match[3]}
            recordings.append(Recording(path.stem, path, None, labels=labels, rates=BANDAI_RATES))
        else:
            left_out.append(
                LeftOut(path.stem, "its name is not one of this dataset; prepare it with `data prepare bvh`")
            )
    there = {recording.labels["part"] for recording in recordings}
    missing = [f"{part} is not there" for part in ("dataset-1", "dataset-2") if part not in there]
    return Survey(BANDAI, recordings, missing, left_out, "none published: every tenth by name")


OWN_FOLDER = Terms(
    title="a folder of BVH",
    origin="the user's own",
    licence="unknown; write it into the manifest before you pass anything on",
    may_ship="what the files' own licence allows",
)
_TWINS = ("wav", "audio", "sound")  # beside a folder bvh/ or motion/
_MUSIC = re.compile(r"music|dance", re.IGNORECASE)


def own_folder(folder: Path) -> Survey:
    """Find every BVH below the folder."""
    recordings = []
    for path in files_below(folder, ".bvh"):
        relative = path.relative_to(folder).with_suffix("")
        split = next((part for part in relative.parts[:-1] if part in ("train", "val", "test")), "")
        domain: Domain = "music" if _MUSIC.search(str(relative)) else "speech"
        name = re.sub(r"[^\w.+-]+", "_", "__".join(relative.parts))
        recordings.append(Recording(name, path, _sound_of(path), domain, split))
    has_split = any(recording.split for recording in recordings)
    return Survey(
        OWN_FOLDER, recordings, (), (), "folders named train, val, test" if has_split else "every tenth by name"
    )


def _sound_of(path: Path) -> Path:
    """The sound file of a motion; if there is none, the path where it would be expected."""
    folders = [path.parent, *(path.parent.parent / twin for twin in _TWINS)]
    found = (sound_named(folder / path.stem) for folder in folders)
    return next(filter(None, found), path.with_suffix(".wav"))


LAYOUTS: dict[str, Callable[[Path], Survey]] = {
    "zeroeggs": zeroeggs,
    "motorica": motorica,
    "beat2": beat2,
    "bandai": bandai,
    "bvh": own_folder,
}


def survey_of(
    kind: str, folder: Path, *, only: Sequence[str] = (), speakers: Sequence[str] = (), has_additional: bool = False
) -> Survey:
    """Find a dataset's recordings.

    Args:
        kind: one of `LAYOUTS`.
        folder: the user's copy: the folder with the files, or one above it.
        only: glob patterns of names; other recordings are left out.
        speakers: numbers or names of speakers; others are left out.
        has_additional: include recordings outside the standard part of the dataset.

    Raises:
        EchoAvatarError: the folder does not exist or holds nothing of this dataset.
    """
    if not folder.is_dir():
        raise EchoAvatarError(f"{folder} is not a folder; pass the folder of your copy of the dataset")
    found = beat2(folder, has_additional=has_additional) if kind == "beat2" else LAYOUTS[kind](folder)
    wanted, left_out = [], list(found.left_out)
    for recording in found.recordings:
        if only and not any(fnmatch.fnmatch(recording.name, glob) for glob in only):
            left_out.append(LeftOut(recording.name, "not among --only"))
        elif speakers and not _speaks(recording, speakers):
            left_out.append(LeftOut(recording.name, "not among --speakers"))
        else:
            wanted.append(recording)
    if not wanted:
        everything = f", all {len(left_out)} left out: {left_out[0].why}" if left_out else ""
        missing = f"; {'; '.join(found.missing)}" if found.missing else ""
        raise EchoAvatarError(f"no recording of {kind} to prepare in {folder}{everything}{missing}")
    return found._replace(recordings=tuple(wanted), left_out=tuple(left_out))


def _speaks(recording: Recording, speakers: Sequence[str]) -> bool:
    own = {recording.labels.get("speaker", ""), recording.labels.get("speaker_name", "")} - {""}
    return bool(own & set(speakers))
