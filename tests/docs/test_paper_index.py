"""docs/paper_index.md: what it names exists, what it computes is right, every switch is in it."""

import importlib
import re
from pathlib import Path

import numpy as np
from lab.tests.recipes.paper_numbers import number, rows

from echoavatar.cli import build_parser
from echoavatar.engine.pipeline.runtime import ADDITIONS
from echoavatar_lab.evaluation.metrics.retrieval import chance

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/paper_index.md").read_text(encoding="utf-8")
NAME = re.compile(r"`((?:echoavatar_\w+|[a-z_]+)(?:\.\w+)+)`")


def section(title: str) -> str:
    return PAGE.partition(f"## {title}")[2].partition("\n## ")[0]


def test_every_module_and_name_exists() -> None:
    others = re.compile(r"model\.|.*\.(json|yaml|csv|md)$")  # keys of a recipe, files
    names = [name for name in NAME.findall(PAGE) if not others.match(name)]
    assert len(names) > 60
    lost = [name for name in names if not any(exists(house + name) for house in ("echoavatar.", "echoavatar_lab.", ""))]
    assert not lost


def exists(name: str) -> bool:
    """Whether a module, or a name or a config's field in a module, is there."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[cut:]:
            fields = getattr(value, "model_fields", {})
            if attribute not in fields and not hasattr(value, attribute):
                return False
            value = fields[attribute] if attribute in fields else getattr(value, attribute)
        return True
    return False


def test_every_recipe_and_page_exists() -> None:
    paths = re.findall(r"`((?:lab|src|studio|tests|web)/[\w/.{},]*)`", PAGE)
    paths += [f"docs/{page}" for page in re.findall(r"\]\(([\w/]+\.md)(?:#[\w-]+)?\)", PAGE)]
    assert len(paths) > 20
    assert [path for path in paths if not list(ROOT.glob(re.sub(r"\{.*?\}", "*", path)))] == []


def test_every_command_and_option_exists() -> None:
    """`WORD ... --option` of the page, as the command's own parser knows them."""
    commands = "animate|align|bench|data|evaluate|reproduce|score|train"
    told = re.findall(rf"`(?:echoavatar )?((?:{commands})(?: [\w-]+| --[\w-]+)*)", PAGE)
    assert len(told) > 25
    for words in {tuple(one.split()) for one in told}:
        parser = next(iter(build_parser([words[0]])._subparsers._group_actions)).choices[words[0]]  # type: ignore[union-attr]
        for word in words[1:]:
            if word.startswith("--"):
                assert word in parser._option_string_actions, words
                continue
            children = [one.choices for one in parser._actions if isinstance(one.choices, dict) and word in one.choices]
            parser = children[0][word] if children else parser


def test_every_field_of_a_config_exists() -> None:
    """`SomeConfig.field`, and `.field` after it."""
    from echoavatar.models.face import FaceConfig
    from echoavatar.models.generator import GeneratorConfig
    from echoavatar.models.tokenizer_config import MotionTokenizerConfig
    from echoavatar_lab.align.audio_reward import AudioMotionConfig
    from echoavatar_lab.align.quality import QualityConfig
    from echoavatar_lab.align.trainer import AlignTraining
    from echoavatar_lab.models.generator.train import GeneratorTraining
    from echoavatar_lab.models.tokenizer.train import TokenizerTraining

    configs = {
        config.__name__: config.model_fields
        for config in (
            AudioMotionConfig, AlignTraining, QualityConfig, FaceConfig, GeneratorConfig, GeneratorTraining,
            MotionTokenizerConfig, TokenizerTraining,
        )
    }  # fmt: skip
    checked = 0
    for line in PAGE.splitlines():
        last = ""
        for config, field in re.findall(r"`(?:[\w.]*?\b([A-Z]\w+))?\.(\w+)`", line):
            last = config or last
            if last in configs:
                assert field in configs[last], f"{last}.{field}"
                checked += 1
    assert checked > 35


def test_every_addition_stands_in_the_list_of_switches() -> None:
    told = section("Where we depart, and the switch")
    listed = set(re.findall(r"`([\w-]+)`", told.partition("How models are trained")[0]))
    assert set(ADDITIONS) <= listed


def test_the_papers_random_mrr_of_all_windows_is_off() -> None:
    everything, few = int(number("gallery of all")), int(number("gallery of small batches"))
    assert round(100 * float(np.mean(1 / np.arange(1, everything + 1))), 3) == 0.447
    assert round(chance(everything).reciprocal_rank, 3) == 0.447 != number("random MRR of all")
    assert round(chance(few).reciprocal_rank, 2) == number("random MRR of small batches")


def test_small_batches_are_one_gallery() -> None:
    """A batch of TMR's size, 32, would give 3.1 % by chance."""
    few = number("gallery of small batches")
    assert round(100 / few, 2) == number("random R@1 of small batches")
    assert number("random MedR of small batches") == few / 2
    table = number("R@1 by BEATs of small batches") / 100 * few
    assert abs(table - round(table)) < 0.02


def test_the_stages_do_not_sum_to_the_total() -> None:
    stages = ("Audio Encoder", "Audio-to-Motion Model", "Motion Decoder", "IK Post-processing")
    for machine, told, total in (("H200", 169.15, 177.426), ("RTX 4090", 205.219, 215.823)):
        assert round(sum(number(f"ms on {machine}: {stage}") for stage in stages), 3) == told
        assert number(f"ms on {machine}: Total Latency") == total
        assert number(f"ms on {machine}: IK Post-processing") > 1.3 * number("ms of IK in the text")
    tokens = 2 * 18
    for machine, rate in (("H200", 351), ("RTX 4090", 303)):
        assert round(1000 * tokens / number(f"ms on {machine}: Audio-to-Motion Model")) == rate


def test_scores_fall_as_fid_rises_but_people_do_not_follow_fid() -> None:
    """Within the table of scores the order holds; the user study's does not follow FID."""
    named = [row["what"].removeprefix("score of ") for row in rows() if row["what"].startswith("score of ")]
    by_fid = sorted(named, key=lambda name: number(f"FID of {name}"))
    scores = [number(f"score of {name}") for name in by_fid]
    assert len(scores) == 22
    assert scores == sorted(scores, reverse=True)
    liked = {row["what"]: float(row["value"].split()[0]) for row in rows() if "±" in row["value"]}
    assert number("FID of EDGE") > number("FID of MECo")
    assert liked["dance overall of EDGE"] > liked["dance overall of MECo"]
    assert number("FID of Ours (GRPO)") > 2 * number("FID of Ours")
    assert liked["dance overall of Ours (GRPO)"] > 0


def test_no_interval_of_the_rl_rows_leaves_out_zero() -> None:
    pairs = [row["value"].split(" ± ") for row in rows() if "of Ours (DPO)" in row["what"] and "±" in row["value"]]
    pairs += [row["value"].split(" ± ") for row in rows() if "of Ours (GRPO)" in row["what"] and "±" in row["value"]]
    assert len(pairs) == 12
    assert all(abs(float(mean)) < float(half) for mean, half in pairs)


def test_truth_is_not_the_best_in_ba_d() -> None:
    named = {row["what"]: float(row["value"]) for row in rows() if row["what"].startswith("BA_D of")}
    assert len(named) == 7
    assert (min(named.values()), max(named.values())) == (2.541, 2.668)
    assert named["BA_D of GT"] < named["BA_D of MECo"] < named["BA_D of EDGE"]
    assert named["BA_D of Ours"] < named["BA_D of GT"]


def test_reconstruction_has_two_fids() -> None:
    assert number("FID of reconstruction") != number("FID of reconstruction (tokenizer table)")
    assert number("commitment in Settings") != number("commitment in the appendix")
