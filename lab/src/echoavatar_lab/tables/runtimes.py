"""How a generator is run, side by side: codes decoded alone (`bare`), as in the paper (`paper`), with all of ours.

The lines share generator, clips and seeds, so they differ in nothing but `engine.pipeline.runtime`. With `--model` a
finished bundle is run on the set's test clips; without, the generator of the other tables. Not in the paper.
"""

from collections.abc import Sequence

from echoavatar.engine import animate_many
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.motion.kinematics import Motion

from .choices import OURS, GeneratorChoice
from .experiment import BATCH, Experiment, motion_of
from .layouts import COLUMNS
from .scores import GENERATION, generation_scores
from .table import Cell, Line, Table, cells
from .waves import Part, generator_waves

NAME = "runtimes"
RUNTIMES = ("bare", "paper", "default")
CHOICE = GeneratorChoice(OURS.name)


def waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `waves`."""
    return [] if experiment.sources.model else generator_waves([CHOICE])


def make(experiment: Experiment) -> Table:
    """Run the generator in each way, score it and make the table."""
    truth = [motion_of(clip) for clip in experiment.test_clips]
    lines = [Line("GT", {}, _scored(experiment, truth))]
    model = experiment.sources.model
    for name in RUNTIMES:
        experiment.say(f"line: {name}")
        run = experiment.again(runtime=name)
        lines.append(
            Line(name, {}, _scored(experiment, _bundles(run, model) if model else run.generated_motions(CHOICE)))
        )
    own = load_bundle(model).runtime if model else Runtime(level_control=False)
    notes = (
        f"{model or 'The generator of the tokenizer ablation'}: one generator, the same clips and seeds in every line.",
        "bare: codes drawn and decoded. paper: besides, the paper's cylinder keeps the hands off the body.",
        f"default: what its bundle says, of ours {', '.join(own.additions)}.",
    )
    return Table(NAME, "Bare codes, the paper's runtime and ours", COLUMNS, lines, notes)


def _bundles(run: Experiment, model: str) -> list[Motion]:
    """Motion of a bundle for the test clips; clip k has the seed `seed` + k."""
    pipeline = Pipeline(load_bundle(model).running(run.runtime), device=run.device)
    made: list[Motion] = []
    for first in range(0, len(run.test_clips), BATCH):
        clips = run.test_clips[first : first + BATCH]
        seeds = range(run.seed + first, run.seed + first + len(clips))
        done = animate_many(pipeline, [clip.audio for clip in clips], seeds=seeds, progress=run.progress)
        made += [one.motion for one in done]
    return made


def _scored(experiment: Experiment, motions: Sequence[Motion]) -> dict[str, Cell]:
    rows = generation_scores(motions, experiment.test_clips, experiment.extractor, seed=experiment.seed)
    return cells(rows, GENERATION)
