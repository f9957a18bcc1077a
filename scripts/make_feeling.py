"""Fit the layer of `echoavatar.motion.feeling`: how a voice differs from itself that is happy, angry, sad or neither.

    python scripts/make_feeling.py RECORDINGS [--held-out NAME ...]

RECORDINGS holds acted speech (see `echoavatar_lab.evaluation.feelings`) and read speech, which is neither. Each voice
says neutral recordings before, or the first half of a reading, and weighs less without. Speakers of the splits
dev and test, and those held out, are not fitted to. The numbers that are printed go into the module.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from echoavatar.models.audio import read_audio
from echoavatar.motion import feeling
from echoavatar.motion.feeling import Feeling, statistics
from echoavatar.timing import CHUNK_SAMPLES, SAMPLE_RATE_HZ
from echoavatar_lab.evaluation.feelings import NAMES, Voices, acted_speech
from echoavatar_lab.models.audio.recordings import MANIFEST, recorded_files

PENALTY = 0.005
OTHER_CORPORA = 0.35  # of the weight, for acted speech outside the largest corpus
READ_VOICES, READ_S, READ_WEIGHT = 60, 12.0, 0.9
COLD = 0.3  # of the weight, for voices that said nothing before

Table = Float[np.ndarray, "n k"]


class Sample(NamedTuple):
    """What was heard in a recording, chunk by chunk, less the speaker's mean."""

    speaker: str
    kind: int  # in `NAMES`
    manner: str  # warm, cold or read
    weight: float
    rows: Table
    statistics: Table


def listen(sound: Float[np.ndarray, " s"], memory: feeling.Memory) -> tuple[Table, Table, feeling.Memory]:
    """Statistics after each chunk of a sound: less the speaker's mean, and whole; and what is remembered of it."""
    voice, rows = Feeling(memory), []
    for number in range(len(sound) // CHUNK_SAMPLES):
        voice.hear(number, sound[number * CHUNK_SAMPLES : (number + 1) * CHUNK_SAMPLES])
        memory = voice.memories[number]
        if memory.sums[2] > feeling.LEAST_HOPS:
            rows.append((statistics(memory.sums) - memory.usual, statistics(memory.sums)))
    less, whole = np.array(rows).reshape(-1, 2, len(feeling.LAYER)).swapaxes(0, 1)
    return less, whole, memory


def samples(folder: Path, held_out: Sequence[str]) -> list[Sample]:
    """What to fit to: acted speech, warm and cold, and readings."""
    speech = [
        each for each in acted_speech(folder) if each.split not in ("dev", "test") and each.speaker not in held_out
    ]
    largest = Counter(each.path.parent for each in speech).most_common(1)[0][0]
    kinds = Counter((each.path.parent == largest, each.feeling) for each in speech)
    found, voices, nothing = [], Voices(speech), feeling.Memory()
    for each in speech:
        is_large = each.path.parent == largest
        weight = (1 - OTHER_CORPORA if is_large else OTHER_CORPORA) / kinds[is_large, each.feeling]
        sound = read_audio(each.path)
        for manner, share, memory in (("warm", 1 - COLD, voices.before(each)), ("cold", COLD, nothing)):
            found.append(Sample(each.speaker, each.feeling, manner, share * weight, *listen(sound, memory)[:2]))
    listed = [file for manifest in folder.rglob(MANIFEST) for file in recorded_files(manifest.parent, "train")]
    readings = [file for file in listed if file.kind == "speech" and "read" in file.style]
    for file in list({file.voice: file for file in readings}.values())[:READ_VOICES]:
        sound = read_audio(file.path)[: int(READ_S * SAMPLE_RATE_HZ)]
        first, rest = np.array_split(sound, 2)
        heard = listen(rest, listen(first, nothing)[2])[:2]
        found.append(Sample(file.voice, 0, "read", READ_WEIGHT / READ_VOICES, *heard))
    return [each for each in found if len(each.rows)]


def fit(used: Sequence[Sample], deviation: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k+1 c"]:
    """Softmax regression, of weights that are penalised and a bias."""
    rows = np.concatenate([scaled(each, deviation) for each in used])
    truth = np.eye(len(NAMES))[np.repeat([each.kind for each in used], [len(each.rows) for each in used])]
    weight = np.concatenate([np.full(len(each.rows), each.weight / len(each.rows)) for each in used])[:, None]

    def loss(flat: Float[np.ndarray, " p"]) -> tuple[float, Float[np.ndarray, " p"]]:
        layer = flat.reshape(-1, len(NAMES))
        shares = shares_of(rows, layer)
        slope = rows.T @ (weight * (shares - truth))
        slope[:-1] += 2 * PENALTY * layer[:-1]
        value = PENALTY * np.square(layer[:-1]).sum() - (weight * truth * np.log(shares + 1e-12)).sum()
        return float(value), slope.ravel()

    start = np.zeros(rows.shape[1] * len(NAMES))
    return np.asarray(minimize(loss, start, jac=True, method="L-BFGS-B").x.reshape(-1, len(NAMES)))


def scaled(each: Sample, deviation: Float[np.ndarray, " k"]) -> Table:
    """Rows in deviations, with a column for the bias."""
    rows = np.clip(each.rows / deviation, -feeling.FARTHEST, feeling.FARTHEST)
    return np.column_stack([rows, np.ones(len(rows))])


def shares_of(rows: Table, layer: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "n c"]:
    """How sure the layer is of each feeling."""
    scores = rows @ layer
    scores = np.exp(scores - scores.max(1, keepdims=True))
    return np.asarray(scores / scores.sum(1, keepdims=True))


def main() -> None:
    """Fit, say how speakers are read who were left out, and print the numbers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--held-out", nargs="*", default=[], metavar="NAME", help="speakers not to fit to")
    args = parser.parse_args()
    found = samples(args.recordings, args.held_out)
    mean = np.mean([each.statistics.mean(0) for each in found if each.kind == 0], 0)
    deviation = np.concatenate([each.rows for each in found if each.weight]).std(0)
    confusion = {manner: np.zeros((4, 4), int) for manner in ("warm", "cold", "read")}
    acted = {each.speaker for each in found if each.kind}
    layers = {left: fit([each for each in found if each.speaker != left], deviation) for left in acted}
    layer = fit(found, deviation)
    for each in found:
        guess = shares_of(scaled(each, deviation), layers.get(each.speaker, layer)).mean(0).argmax()
        confusion[each.manner][each.kind, guess] += 1
    for name, table in confusion.items():
        print(f"{name}\n{table}")
    for name, *row in zip(feeling.LAYER, mean, deviation, *layer[:-1].T, strict=True):
        print(f'    "{name}": ({", ".join(f"{value:.3g}" for value in row)}),')
    print(f"BIAS = ({', '.join(f'{value:.3g}' for value in layer[-1])})")


if __name__ == "__main__":
    main()
