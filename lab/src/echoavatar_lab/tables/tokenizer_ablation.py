"""The paper's table "Quantitative comparison results" (Motion Tokenizer): an ablation of the tokenizer.

As in the paper, every line but the last has one tokenizer for the whole body with the same quantiser, and so a third
of the codes; "w/ bodypart" is the full model. We read the names as follows:

- w/o dual keeps only the MLP path.
- w/o auxiliary drops every loss term of forward kinematics.
- w/o lookback sees no past frame; the paper does not say whether it means none or no limit.
- CausalConv has residual convolutions instead of attention, and strided ones between the levels; the losses are the
  same.
"""

from collections.abc import Sequence

from echoavatar_lab.models.tokenizer.losses import LossWeights

from .experiment import Experiment
from .scale import OURS, GeneratorChoice, Part, TokenizerChoice, generator_waves
from .scores import GENERATION, generation_cells, reconstruction_scores
from .table import Cell, Claim, Column, Line, Table, Wanted

NAME = "tokenizer-ablation"
NO_AUXILIARY = LossWeights(position=0, velocity=0, acceleration=0, foot_velocity=0, foot_position=0)
COLUMNS = (
    Column("fid", "Reconstruction FID"),
    Column("mpjpe", "MPJPE", "1e-4 m"),
    Column("trans", "Trans Loss", "1e-4 m"),
    Column("generation_fid", "Generation FID"),
)


VARIANTS: tuple[tuple[str, tuple[float, ...], TokenizerChoice], ...] = (
    (
        "CausalConv-RVQ",
        (9.208, 525.6, 12.94, 18.06),
        TokenizerChoice("causal-conv", sizes={"blocks": "convolution", "resampling": "strided"}, is_whole=True),
    ),
    ("Attn", (4.183, 411.6, 12.53, 12.25), TokenizerChoice("attention", is_whole=True)),
    (
        "Attn (w/o dual)",
        (12.21, 982.4, 48.77, 18.55),
        TokenizerChoice("without-dual", sizes={"resampling": "learned"}, is_whole=True),
    ),
    (
        "Attn (w/o auxiliary)",
        (8.775, 778.5, 55.67, 17.68),
        TokenizerChoice("without-auxiliary", losses=NO_AUXILIARY, is_whole=True),
    ),
    (
        "Attn (w/o lookback)",
        (6.612, 468.8, 12.89, 15.53),
        TokenizerChoice("without-lookback", sizes={"lookback": 0}, is_whole=True),
    ),
    ("Attn (w/ bodypart)", (1.306, 184.1, 9.637, 9.465), OURS),
)

_KEYS = [column.key for column in COLUMNS]
CLAIMS = (
    *(Claim("Attn", name, _KEYS) for name, _, _ in VARIANTS if name not in ("Attn", "Attn (w/ bodypart)")),
    Claim("Attn (w/ bodypart)", "Attn", _KEYS),
)
"""Every component improves every column, and attention is better than convolution (paper, Ablation Study)."""


def waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `scale.generator_waves`."""
    return generator_waves([GeneratorChoice(choice.name, tokenizer=choice) for _, _, choice in VARIANTS])


def make(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    lines = [Line("Real motion", dict.fromkeys(_KEYS, 0.0), dict.fromkeys(_KEYS, Cell(0.0)))]
    lines.append(Line("Real motion, one half against the other", {}, _halves(experiment)))
    for name, paper, choice in VARIANTS:
        experiment.say(f"line: {name}")
        tokenizer = experiment.tokenizer(choice)
        ours = reconstruction_scores(tokenizer, experiment.test_clips, experiment.extractor, seed=experiment.seed)
        generator = GeneratorChoice(choice.name, tokenizer=choice)
        ours |= generation_cells(
            experiment, experiment.generated_motions(generator), {"generation_fid": GENERATION["fid"]}
        )
        lines.append(Line(name, dict(zip(_KEYS, paper, strict=True)), ours))
    notes = (
        "Lines but the last: one tokenizer for the whole body, the same quantiser, so a third of the codes.",
        "w/o dual: the MLP path alone. w/o auxiliary: no term of forward kinematics. w/o lookback: no past frame; "
        "the paper does not say whether none or without limit.",
        "MPJPE is over all joints, both roots at the origin and both hips facing ahead.",
    )
    return Table(NAME, "Tokenizer ablation (paper, Motion Tokenizer)", COLUMNS, lines, notes, CLAIMS)


def _halves(experiment: Experiment) -> dict[str, Cell]:
    """FID between test clips and other test clips: what motion of the same kind scores."""
    halves = Wanted("fid", part="truth")
    return generation_cells(experiment, experiment.true_motions, {"fid": halves, "generation_fid": halves})
