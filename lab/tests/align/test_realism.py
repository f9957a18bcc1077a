"""The realism reward prefers bodies that move as the captured ones do, and refuses what it was not fitted to."""

import json
from pathlib import Path

import numpy as np
import pytest
from lab.tests.align.moving_bodies import LEAD, reference_statistics, scene
from lab.tests.align.tuning_fakes import save_clips
from lab.tests.evaluation.test_alive import swaying
from lab.tests.evaluation.test_takes import name_people

from echoavatar.cli import main
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.motion.formats import write_bvh
from echoavatar_lab.align import realism
from echoavatar_lab.align.realism import KindConfig, Realism
from echoavatar_lab.evaluation.metrics.distributions import fit

FRAMES = 160
OWN = reference_statistics()


def body(level: float, domain: int = 2, frames: int = FRAMES):
    """All joints circle at about `level` m/s."""
    steps = np.random.default_rng(int(1e3 * level)).uniform(0.8, 1.2, frames + LEAD)
    return scene(level * steps, domain=domain)


@pytest.fixture(scope="module")
def prefers_fast() -> Realism:
    """Generated bodies are slow and captured ones fast."""
    rows = [
        realism._statistics(realism._points(body(level), FRAMES), 30.0, FRAMES / 30)
        for levels in (np.linspace(0.2, 0.5, 24), np.linspace(0.6, 0.9, 24))
        for level in levels
    ]
    fitted = fit(np.array(rows), np.repeat([1.0, 0.0], 24))._asdict()
    return Realism(
        seconds=FRAMES / 30, kinds={"music": KindConfig(**{name: tuple(map(float, v)) for name, v in fitted.items()})}
    )


def test_it_pays_what_the_captured_ones_do(prefers_fast: Realism) -> None:
    slow, middle, fast = (prefers_fast.judge(body(level), OWN) for level in (0.3, 0.55, 0.75))
    assert -4 <= slow < -1 < middle < 1.5 < fast <= 4
    assert prefers_fast.judge(body(50.0), OWN) >= -4  # far from both sides: limited


def test_other_sound_and_bodies_upside_down_are_not_taken_for_people(prefers_fast: Realism) -> None:
    assert prefers_fast.judge(body(0.3, domain=1), OWN) == 0
    fallen = body(0.75)
    fallen.positions[..., 1] *= -1
    assert prefers_fast.judge(fallen, OWN) == -4


def test_another_length_is_refused(prefers_fast: Realism) -> None:
    with pytest.raises(EchoAvatarError, match="continuations of 20 chunks, not of 15: fit it with the same --length"):
        prefers_fast.judge(body(0.3, frames=120), OWN)


def test_it_is_kept_in_a_file(prefers_fast: Realism, tmp_path: Path) -> None:
    prefers_fast.save(tmp_path / "new/realism.json")
    assert Realism.load(tmp_path / "new/realism.json") == prefers_fast
    (tmp_path / "cut.json").write_text('{"seconds": 5')
    kind = {"mean": [0.0], "spread": [1.0], "weights": [0.0] * 3}
    (tmp_path / "short.json").write_text(json.dumps({"seconds": 5, "kinds": {"music": kind}}))
    for name in ("cut.json", "short.json", "missing.json"):
        with pytest.raises(CheckpointError, match=rf"{name} holds no realism reward"):
            Realism.load(tmp_path / name)


def test_the_commands_fit_it_and_tune_with_it(
    tmp_path: Path, tiny_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "people").mkdir()
    for name, size in (("dance_a", 0.2), ("dance_b", 0.4)):
        motion = swaying(400, size=size)
        write_bvh(tmp_path / "people" / f"{name}.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    name_people(tmp_path / "people", *(("music", name, "any", name) for name in ("dance_a", "dance_b")))
    tokens = save_clips(tmp_path / "tokens", 3, 18, held_out=True)
    common = [str(tokens), "--model", str(tiny_bundle)]
    sizes = ["--past", "2", "--own-past", "1", "--length", "12"]
    asked = ["align", "reward-realism", *common, "--captured", str(tmp_path / "people"), *sizes]
    file = str(tmp_path / "realism.json")
    assert main([*asked, "-o", file, "--prompts", "12", "--group", "2"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert list(found) == ["music"]
    assert found["music"]["generated"] == 24
    assert found["music"]["told_apart"] > 0.6  # random codes do not sway like these
    tuned = ["align", "grpo", *common, "-o", str(tmp_path / "tuned"), "--recipe", "tiny", *sizes, "--steps", "2"]
    assert main([*tuned, "--realism", file, "--reward", "realism=0.1", "--fewest-events", "0"]) == 0
    lines = [json.loads(line) for line in (tmp_path / "tuned/metrics.jsonl").read_text().splitlines()]
    assert any("rewards.realism" in line for line in lines)
    train_only = str(save_clips(tmp_path / "train", 3, 18))
    assert main([asked[0], asked[1], train_only, *asked[3:], "-o", file, "--prompts", "12", "--group", "2"]) == 0
    assert main([*asked, "-o", file, "--prompts", "4", "--group", "2"]) == 1
    assert "at least 20 of each are needed: raise --prompts" in capsys.readouterr().err
    assert main([*asked, "-o", file, "--own-past", "3"]) == 1
    assert "--own-past (3) chunks are the last of --past (2): lower it" in capsys.readouterr().err
