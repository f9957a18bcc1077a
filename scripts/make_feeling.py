"""Fit `engine/feeling.json`: how a voice sounds that is happy, angry, sad or none of these.

    python scripts/make_feeling.py RECORDINGS

RECORDINGS is a folder with a manifest.csv (see `echoavatar_lab.models.audio.recordings`). Speech of its train split is
used: acted speech, whose title names an emotion, and read speech, which is none. Folds are by speaker; the strength of
the penalty is the one whose folds tell acted speech apart best.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize

import echoavatar
from echoavatar.engine.feeling import FEELINGS, Feeling, statistics
from echoavatar.models.audio import read_audio
from echoavatar.timing import CHUNK_SAMPLES, SAMPLE_RATE_HZ
from echoavatar_lab.models.audio.recordings import recorded_files

TARGET = Path(echoavatar.__file__).parent / "engine" / "feeling.json"
CLASSES = {"neutral": 0, "happiness": 1, "anger": 2, "sadness": 3}
READ_VOICES, READ_S = 150, 6.0  # voices of read speech, and seconds of each
READ_WEIGHT = 0.3  # of all read speech, beside each class of acted speech
LEAST_FRAMES = 20  # of speech before a sample is taken
PENALTIES = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2)

Table = Float[np.ndarray, "n k"]


def samples(path: Path, seconds: float = 60.0) -> Table:
    """The statistics after each chunk of a recording."""
    sound = read_audio(path)[: int(seconds * SAMPLE_RATE_HZ)]
    feeling, rows = Feeling(), []
    for number, piece in enumerate(sound[: len(sound) // CHUNK_SAMPLES * CHUNK_SAMPLES].reshape(-1, CHUNK_SAMPLES)):
        feeling.hear(number, piece)
        sums = feeling._memories[number].sums  # noqa: SLF001
        if sums[0] >= LEAST_FRAMES:
            rows.append(statistics(sums))
    return np.array(rows).reshape(len(rows), -1)


def fit(
    tables: Sequence[Table], labels: Sequence[int], weights: Sequence[float], penalty: float
) -> dict[str, Float[np.ndarray, "..."]]:
    """The layer: softmax regression with a penalty on its weights. `weights` are of the recordings."""
    x, y = np.concatenate(tables), np.repeat(labels, [len(table) for table in tables])
    w = np.concatenate([np.full(len(table), each / len(table)) for table, each in zip(tables, weights, strict=True)])
    mean, deviation = x.mean(0), x.std(0) + 1e-9
    z, classes, w = (x - mean) / deviation, 1 + len(FEELINGS), w / w.sum()
    truth = np.eye(classes)[y]

    def loss(flat: Float[np.ndarray, " p"]) -> tuple[float, Float[np.ndarray, " p"]]:
        layer = flat.reshape(classes, -1)
        scores = z @ layer[:, 1:].T + layer[:, 0]
        scores -= scores.max(1, keepdims=True)
        shares = np.exp(scores) / np.exp(scores).sum(1, keepdims=True)
        wrong = (shares - truth) * w[:, None]
        slope = np.column_stack([wrong.sum(0), wrong.T @ z + 2 * penalty * layer[:, 1:]])
        value = -(w * np.log((shares * truth).sum(1) + 1e-12)).sum() + penalty * (layer[:, 1:] ** 2).sum()
        return float(value), slope.ravel()

    found = minimize(loss, np.zeros(classes * (1 + x.shape[1])), jac=True, method="L-BFGS-B").x.reshape(classes, -1)
    return {"mean": mean, "deviation": deviation, "weights": found[:, 1:], "bias": found[:, 0]}


def guess(layer: dict[str, Float[np.ndarray, "..."]], table: Table) -> int:
    """The class of a recording: of the mean over its samples."""
    scores = (table - layer["mean"]) / layer["deviation"] @ layer["weights"].T + layer["bias"]
    shares = np.exp(scores - scores.max(1, keepdims=True))
    return int((shares / shares.sum(1, keepdims=True)).mean(0).argmax())


def evenly(labels: Sequence[int], is_acted: Sequence[bool]) -> list[float]:
    """Weights of recordings: classes of acted speech count alike, and all read speech less than one of them."""
    kinds = [label if acted else -1 for label, acted in zip(labels, is_acted, strict=True)]
    return [(1.0 if kind >= 0 else READ_WEIGHT) / kinds.count(kind) for kind in kinds]


def confusion(truth: Sequence[int], guessed: Sequence[int]) -> Int[np.ndarray, "c c"]:
    """Counts by truth and guess."""
    table = np.zeros((1 + len(FEELINGS), 1 + len(FEELINGS)), int)
    np.add.at(table, (np.array(truth), np.array(guessed)), 1)
    return table


def main() -> None:
    """Fit, say how well speakers who were left out are told apart, and write the numbers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, help="folder with a manifest.csv")
    folder = parser.parse_args().recordings
    speech = [file for file in recorded_files(folder, "train") if file.kind == "speech"]
    read = {file.voice: file for file in speech if "acted" not in file.style}
    acted = [file for file in speech if "acted" in file.style and file.title.split()[-1] in CLASSES]
    used = [*acted, *list(read.values())[:READ_VOICES]]
    is_acted = ["acted" in file.style for file in used]
    labels = [CLASSES[file.title.split()[-1]] if acts else 0 for file, acts in zip(used, is_acted, strict=True)]
    tables = [samples(file.path, 60.0 if acts else READ_S) for file, acts in zip(used, is_acted, strict=True)]
    kept = [at for at, table in enumerate(tables) if len(table)]
    used, is_acted, labels, tables = ([each[at] for at in kept] for each in (used, is_acted, labels, tables))
    speakers = [file.voice for file in used]
    actors = sorted({speaker for speaker, acts in zip(speakers, is_acted, strict=True) if acts})
    best, chosen = 0.0, PENALTIES[0]
    for penalty in PENALTIES:
        truth, guessed = [], []
        for actor in actors:
            rest = [at for at, speaker in enumerate(speakers) if speaker != actor]
            weights = evenly([labels[at] for at in rest], [is_acted[at] for at in rest])
            layer = fit([tables[at] for at in rest], [labels[at] for at in rest], weights, penalty)
            own = [at for at, speaker in enumerate(speakers) if speaker == actor]
            truth += [labels[at] for at in own]
            guessed += [guess(layer, tables[at]) for at in own]
        table = confusion(truth, guessed)
        right = float(np.mean(np.diag(table) / table.sum(1)))
        print(f"penalty {penalty:g}: {right:.2f} right, of speakers left out\n{table}")
        if right > best:
            best, chosen = right, penalty
    layer = fit(tables, labels, evenly(labels, is_acted), chosen)
    TARGET.write_text(json.dumps({name: np.round(value, 4).tolist() for name, value in layer.items()}) + "\n")
    print(f"{len(used)} recordings, penalty {chosen:g}: {TARGET}")


if __name__ == "__main__":
    main()
