"""The trade-off table: a line for each method, rewards of held-out prompts, the paper's numbers beside ours."""

import json

import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.evaluation.metrics.retrieval import chance
from echoavatar_lab.tables import alignment, scores
from echoavatar_lab.tables.alignment import QUOTED, RETRIEVAL_COLUMNS, _quoted, _retrieval_lines
from echoavatar_lab.tables.experiment import Sources
from echoavatar_lab.tables.table import Table

PROBES = (
    {"step": 0, "held_out": {"rewards": {"quality": [0.5, 0.1], "alignment": [0.2, 0.0]}, "kl": 0.0}},
    {"step": 1, "loss": 0.1, "rewards.quality": 0.4, "rewards.alignment": 0.1, "kl": 0.3},
    {"step": 2, "held_out": {"rewards": {"quality": [0.7, 0.1], "alignment": [0.3, 0.0]}, "kl": 0.04}},
)


@pytest.fixture
def experiment(tmp_path):
    made = FakeExperiment()
    made.folder = tmp_path
    run = tmp_path / "alignment" / "grpo"
    run.mkdir(parents=True)
    (run / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in PROBES))
    return made


def test_rewards_are_of_held_out_prompts_with_their_error(experiment):
    folder = experiment.folder / "alignment" / "grpo"
    last, first = alignment.rewards_of(folder), alignment.rewards_of(folder, is_first=True)
    assert last["quality"][:3] == pytest.approx((0.7, 0.7 - 0.196, 0.7 + 0.196))
    assert (first["quality"].value, first["kl"].value, last["kl"].value) == (0.5, 0.0, 0.04)


def test_every_method_has_a_line_and_the_untuned_one_the_rewards_it_began_with(experiment, monkeypatch):
    asked = []

    def tuned(where, method):
        asked.append(method)
        rewards = alignment.rewards_of(where.folder / "alignment" / "grpo")
        return alignment.TunedOutcome(where.true_motions, rewards)

    monkeypatch.setattr(scores, "generation_scores", counted)
    monkeypatch.setattr(alignment, "tuned", tuned)
    table = alignment.make(experiment)
    assert table.claims == alignment.CLAIMS, "the table judges them"
    lines = {line.name: line for line in table.lines}
    assert asked == ["dpo", "grpo", "ppo"]
    assert experiment.asked == ["body-parts"]
    assert lines["Ours (no RL)"].ours["quality"].value == 0.5
    assert lines["Ours (DPO)"].ours["quality"].value == 0.7
    assert lines["Ours (GRPO)"].paper["fid"] == 24.13
    assert lines["Ours (PPO)"].paper == {"fid": 24.97}
    assert "quality" not in lines["GT"].ours


def test_windows_are_no_longer_than_the_clips():
    class Short:
        chunks = 11

    assert alignment.reward_window({"a": Short()}) == 11
    Short.chunks = 40
    assert alignment.reward_window({"a": Short()}) == alignment.WINDOW_CHUNKS


def test_a_reward_of_other_codes_is_refused(tmp_path, monkeypatch):
    """The reward must be that of the codes it judges: another codec or tokenizer makes it worthless."""
    made = []

    class Codes:
        folder, seed, scale, codes, sources = tmp_path, 0, FakeExperiment.scale, "one", Sources()

        def codes_settings(self, choice):
            return {"codes": self.codes}

    monkeypatch.setattr(alignment, "alignment_settings", lambda experiment: (None, None))
    monkeypatch.setattr(alignment, "_windows", lambda experiment, clips: None)
    monkeypatch.setattr(alignment.AudioMotion, "load", lambda folder: folder)
    monkeypatch.setattr(alignment, "AudioRewardTask", lambda *a: None)
    monkeypatch.setattr(alignment, "train", lambda *a: made.append(1))
    experiment = Codes()
    for _ in range(2):
        assert alignment.alignment_reward(experiment, {}) == tmp_path / "rewards" / "alignment"
    assert made == [1]
    experiment.codes = "other"
    with pytest.raises(EchoAvatarError, match="rewards/alignment was made with other settings or from other parts"):
        alignment.alignment_reward(experiment, {})


def test_the_papers_chance_is_chance_but_for_its_mrr() -> None:
    for pairs, quoted in ((1808, QUOTED[2]), (300, QUOTED[5])):
        guess = chance(pairs, (1, 3, 5, 10))
        for wanted, found in zip(guess.recall.values(), quoted.a2m, strict=False):
            assert abs(wanted - found) < 0.006
        assert abs(guess.median_rank - quoted.a2m[4]) <= 0.5
    assert round(chance(1808, (1,)).reciprocal_rank, 3) == 0.447  # the paper says 0.41
    assert round(chance(300, (1,)).reciprocal_rank, 2) == QUOTED[5].a2m[5]


def test_every_column_has_the_papers_numbers_and_ours() -> None:
    found = chance(10, (1, 3, 5, 10))
    ours, guess = _retrieval_lines("all (10)", found, found)
    keys = [column.key for column in RETRIEVAL_COLUMNS]
    assert list(_quoted(QUOTED[0])) == list(ours.ours) == list(guess.ours) == keys
    assert Table("t", "", RETRIEVAL_COLUMNS, [ours]).has_ours(RETRIEVAL_COLUMNS[0])
