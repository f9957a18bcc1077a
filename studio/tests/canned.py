"""Small studies without a model: procedural motion, a hum for sound. For tests, and to look at the pages:

python -m studio.tests.canned --folder FOLDER --port 8766
"""

import argparse
import shutil
import sys
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml

from echoavatar.motion.formats.tables import write_npz
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar.wire.rates import Rate
from echoavatar_studio import making
from echoavatar_studio.app import create_app
from echoavatar_studio.clips import Performance, corrupt, save_clip, save_sound
from echoavatar_studio.http import Rates
from echoavatar_studio.making import Maker, Material
from echoavatar_studio.owner_actions import OwnerActions
from echoavatar_studio.run import open_store, serve
from echoavatar_studio.secrecy import hash_password
from echoavatar_studio.settings import PairwiseStudy, SoundChoice, SystemChoice, parse_study
from echoavatar_studio.store import Store, sqlite_url
from echoavatar_studio.tables import Owner
from echoavatar_studio.wire_owner import Invite

PASSWORD = "a long password"
EASY = Rates(*[Rate(1e6, 1e6)] * 6)
SYSTEMS = ("Alpha", "Beta", "Gamma")


def moving(seconds: float, speed: float, size: float = 0.5) -> Motion:
    """Arms and spine that swing at a pace of their own."""
    frames = round(seconds * FRAME_RATE_HZ)
    turns = np.zeros((frames, HUMANOID.joints, 3), np.float32)
    swing = size * np.sin(np.arange(frames) / FRAME_RATE_HZ * speed * 2 * np.pi)
    for name, axis, factor in (
        ("spine", 2, 0.3), ("leftUpperArm", 2, -1.0), ("rightUpperArm", 2, 1.0), ("leftLowerArm", 1, -1.0),
        ("head", 1, 0.5),
    ):  # fmt: skip
        turns[:, HUMANOID.index(name), axis] = factor * swing
    for name, sign in (("leftUpperArm", -1.0), ("rightUpperArm", 1.0)):
        turns[:, HUMANOID.index(name), 2] += sign * 1.1
    root = np.broadcast_to(HUMANOID.offsets[:1], (frames, 3)).copy()
    return Motion(HUMANOID, quaternion_from_axis_angle(turns), root, float(FRAME_RATE_HZ))


def hum(seconds: float, pitch: float) -> np.ndarray:
    time = np.arange(round(seconds * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    beat = np.exp(-8 * (time % 0.5))
    return (0.3 * np.sin(2 * np.pi * pitch * time) * beat).astype(np.float32)


def library(folder: Path, *, sounds: int = 4, seconds: float = 1.0) -> None:
    """`music` and `speech` with half of the sounds each, and a folder of clips for each of `SYSTEMS`."""
    for number in range(sounds):
        kind = ("music", "speech")[number % 2]
        name = f"{kind} {number // 2}"
        save_sound(folder / kind / f"{name}.flac", hum(seconds, 220 + 60 * number))
        for place, system in enumerate(SYSTEMS):
            (folder / system).mkdir(parents=True, exist_ok=True)
            write_npz(folder / system / f"{name}.npz", moving(seconds, 0.5 + 0.4 * place + 0.1 * number))


def pairwise_text(**changes: object) -> str:
    settings = {
        "kind": "pairwise",
        "title": "Canned pairs",
        "systems": [{"name": name, "clips": name, "group": "Canned"} for name in SYSTEMS],
        "sounds": [{"path": "music", "category": "dance"}, {"path": "speech", "category": "gesture"}],
        "seconds": 1.0, "raters": 6, "tasks_per_rater": 6, "training": 1,
        "checks": {"identical": 1, "corrupted": 1},
    } | changes  # fmt: skip

    return yaml.safe_dump(settings)


def preference_text(**changes: object) -> str:
    settings = {
        "kind": "preference", "title": "Canned candidates", "model": "default", "candidates": 8, "past": 1,
        "length": 2, "sounds": [{"path": "music", "category": "dance"}], "raters": 4, "tasks_per_rater": 3,
        "training": 1, "checks": {"identical": 0, "corrupted": 1}, "keep": {"votes": 2},
    } | changes  # fmt: skip
    return yaml.safe_dump(settings)


def make_pairwise(maker: Maker, base: Path, **changes: object) -> str:
    """An open pairwise study; returns its public name. Its clips are made once and then copied: that is quicker."""
    settings = parse_study(pairwise_text(**changes))
    assert settings.kind == "pairwise"
    public = maker.begin(settings, by="test")
    rows, folder = _clips(base, settings.systems, settings.sounds, settings.seconds)
    shutil.copytree(folder, maker.media / public)
    with maker.store.write() as session:
        maker.write(session, public, settings, rows)
    return public


_KEPT = tempfile.TemporaryDirectory(prefix="studio-clips-")


@lru_cache(maxsize=32)
def _clips(
    base: Path, systems: tuple[SystemChoice, ...], sounds: tuple[SoundChoice, ...], seconds: float
) -> tuple[list[Material], Path]:
    text = {"kind": "pairwise", "title": "Clips", "raters": 1, "systems": systems, "sounds": sounds, "seconds": seconds}
    folder = Path(tempfile.mkdtemp(dir=_KEPT.name))
    return making.make_pairwise(PairwiseStudy.model_validate(text), base, folder, lambda *_: None), folder


def make_preference(maker: Maker, *, seconds: float = 1.0, prompts: int = 3, **changes: object) -> str:
    """An open preference study whose codes are numbers: candidate k says k everywhere."""
    settings = parse_study(preference_text(**changes))
    public = maker.begin(settings, by="test")
    rows = []
    for number in range(prompts):
        folder, clips = maker.media / public, []
        for k in range(settings.candidates):
            shown = Performance(moving(seconds, 0.4 + 0.2 * k + 0.05 * number))
            save_clip(folder / f"{number:03d}-{k:02d}.motion", shown)
            codes = [[[k % 8] * 2] * 3] * (2 * settings.length)
            clips.append((f"candidate {k + 1}", f"{number:03d}-{k:02d}.motion", 1000 + k, codes))
        save_sound(folder / f"{number:03d}.flac", hum(seconds, 200 + 50 * number))
        save_clip(folder / f"{number:03d}-x.motion", corrupt(shown, number))
        prompt = {"clip": f"clip{number}", "start": 0, "past": settings.past}
        sound, kind = f"{number:03d}.flac", ("dance", "gesture")[number % 2]
        rows.append(Material(f"sound {number}", kind, sound, seconds, tuple(clips), f"{number:03d}-x.motion", prompt))
    with maker.store.write() as session:
        maker.write(session, public, settings, rows)
    return public


@lru_cache(maxsize=1)
def _migrated() -> bytes:
    """An empty SQLite store: making one takes longer than copying it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "studio.db"
        store = Store(sqlite_url(path))
        with store.engine.connect() as connection:
            connection.exec_driver_sql("ROLLBACK")
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
        store.close()
        return path.read_bytes()


@lru_cache(maxsize=1)
def _hashed() -> str:
    return hash_password(PASSWORD)


def studio(folder: Path, url: str | None = None) -> Maker:
    """An empty studio with the owner `anna`."""
    if url is None and not (folder / "studio.db").exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "studio.db").write_bytes(_migrated())
    store: Store = open_store(folder, url)
    with store.write() as session:
        if session.query(Owner).count() == 0:
            session.add(Owner(name="anna", password=_hashed(), created=0.0))
    return Maker(store, folder / "media")


def main() -> None:
    parser = argparse.ArgumentParser(description="serve canned studies; owner anna, password 'a long password'")
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--store")
    parser.add_argument("--port", type=int, default=8766)
    parser.add_argument("--seconds", type=float, default=4.0)
    args = parser.parse_args()
    maker = studio(args.folder, args.store)
    actions, place = OwnerActions(maker, "canned"), args.folder / "library"
    if not actions.studies().studies:
        library(place, seconds=args.seconds)
        make_pairwise(maker, place, seconds=args.seconds, presentation="side_by_side", title="Side by side")
        make_pairwise(maker, place, seconds=args.seconds)
        make_preference(maker, seconds=args.seconds)

    def ready(address: str) -> None:
        sys.stdout.write(f"{address}/  owner anna, password {PASSWORD!r}\n")
        for row in actions.studies().studies:
            links = actions.invite(row.id, Invite(count=row.raters_wanted), page=f"{address}/rate").links
            sys.stdout.write("".join(f"{line}\n" for line in (row.title, *(link.url for link in links))))
        sys.stdout.flush()

    serve(create_app(maker, library=place, rates=EASY), host="127.0.0.1", port=args.port, on_ready=ready)


if __name__ == "__main__":
    main()
