"""Candidates of a small bundle: drawn, shown, and exported to a step of DPO."""

import io
import json
import zipfile

import numpy as np
import pytest
import torch
import yaml
from studio.tests import canned
from studio.tests.people import RaterPerson, app_of, tokens

from echoavatar.cli import main
from echoavatar.engine import animate, in_blocks
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import AudioError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenize import audio_codes
from echoavatar_studio.candidates import candidates, decode, starts, token_file
from echoavatar_studio.clips import save_sound
from echoavatar_studio.export import export
from echoavatar_studio.making import Maker
from echoavatar_studio.settings import parse_study
from echoavatar_studio.sources import SoundCut
from echoavatar_studio.tables import Task


@pytest.fixture(scope="module")
def bundle(tiny_bundle):
    return load_bundle(tiny_bundle)


def cut(seconds: float = 3.0) -> SoundCut:
    return SoundCut("hum 1", "hum 1", "gesture", 0.0, canned.hum(seconds, 200))


def settings(**changes):
    return parse_study(canned.preference_text(candidates=3, past=1, length=2, **changes))


def test_a_prompt_is_continued_in_as_many_ways_as_asked_each_with_its_seed(bundle, tmp_path):
    pipeline, study = Pipeline(bundle), settings()
    clip = token_file(tmp_path, bundle, cut(), 0)
    found, again = (candidates(pipeline, bundle, cut(), clip, 2, study) for _ in range(2))
    assert [np.array(one.codes).shape for one in found] == [(4, 3, 2)] * 3  # two chunks, three parts, two layers
    assert len({one.seed for one in found}) == 3
    assert [one.shown.motion.frames for one in found] == [16] * 3
    assert [one.codes for one in found] == [one.codes for one in again]
    assert found[0].codes != found[1].codes
    stored = TokenClip.load(tmp_path / "hum_1.npz")
    assert not stored.has_truth
    assert stored.chunks == clip.chunks == 11


@pytest.mark.parametrize("has_manner", [False, True])
def test_what_is_shown_is_what_the_live_engine_shows_for_the_same_codes(bundle, has_manner):
    """Codes that a live session drew, decoded here, are its motion; with a manner, the legs of a talker stand apart."""
    pipeline, later, drawn = Pipeline(bundle), Pipeline(bundle), []
    pipeline.has_manner = later.has_manner = has_manner
    pipeline.additions -= {"idle"}  # shifts of weight
    pipeline.warm_up()
    step = pipeline.generator.step

    def listening(*args, **kwargs):
        drawn.append(step(*args, **kwargs | {"manner": None}))
        return drawn[-1]

    pipeline.generator.step = listening
    sound = canned.hum(8 * 4 / 15, 200)
    live = animate(pipeline, in_blocks(sound), seed=5)
    shown = decode(later, sound, torch.from_numpy(np.concatenate(drawn, 1)[:, :16]))[0]
    # the session adds glances of its own; the root and the legs are the pipeline's
    assert np.abs(live.motion.root - shown.motion.root).max() < 0.03
    turned = np.abs((live.motion.rotations * shown.motion.rotations).sum(-1)).clip(0, 1)
    degrees = np.degrees(2 * np.arccos(turned)).mean(0)
    assert degrees.mean() < 3
    assert degrees[HUMANOID.indices(["leftUpperLeg", "rightUpperLeg", "leftFoot", "rightFoot"])].max() < 0.5


def test_prompts_are_spread_over_a_sound_and_short_ones_are_refused(bundle, tmp_path):
    clip = token_file(tmp_path, bundle, cut(), 0)
    assert starts(clip, settings(prompts_per_sound=3), "hum") == [0, 4, 8]
    assert len(audio_codes(bundle.codec, cut().audio)) == 225
    with pytest.raises(AudioError, match="hum has 11 chunks"):
        starts(clip, settings().model_copy(update={"length": 20}), "hum")
    with pytest.raises(AudioError, match="shorter than a chunk"):
        token_file(tmp_path, bundle, cut(0.1), 0)


@pytest.mark.slow
def test_from_sounds_over_raters_to_a_step_of_dpo(tiny_bundle, maker: Maker, tmp_path, capsys):
    """study.yaml -> candidates -> two raters who agree -> pairs.jsonl and tokens.zip -> `align dpo`, one step."""
    for number in range(3):
        save_sound(tmp_path / "speech" / f"talk {number}.flac", canned.hum(3.0, 150 + 40 * number))
    text = canned.preference_text(
        model=str(tiny_bundle), candidates=3, raters=2, prompts_per_sound=2, tasks_per_rater=6,
        sounds=[{"path": "speech", "category": "gesture"}],
    )  # fmt: skip
    study = parse_study(yaml.dump(yaml.safe_load(text)))
    public = maker.begin(study, by="test")
    maker.make(public, study, tmp_path)
    app = app_of(maker)
    with maker.store.read() as session:
        order = {task.public: task.order for task in session.query(Task)}
    for token in tokens(maker, public, 2):
        rater = RaterPerson(app).begin(token)
        while (task := rater.task()) is not None:
            best, worst = (order[task["id"]].index(place) for place in (1, 0))
            assert rater.answer(task, best=best, worst=worst).status_code == 200
    lines = export(maker.store, maker.media, public, "pairs.jsonl")
    assert len(lines.splitlines()) == 6
    first = json.loads(lines.splitlines()[0])
    assert (first["by"], first["past"], len(first["seeds"])) == ("2 raters", 1, 2)
    pairs = tmp_path / "pairs.jsonl"
    pairs.write_bytes(lines)
    with zipfile.ZipFile(io.BytesIO(export(maker.store, maker.media, public, "tokens.zip"))) as whole:
        whole.extractall(tmp_path / "mine")
    folder = tmp_path / "mine" / "tokens"
    words = ["align", "dpo", str(folder), "-o", str(tmp_path / "run"), "--pairs", str(pairs), "--recipe", "tiny"]
    words += ["--model", str(tiny_bundle), "--past", "1", "--length", "2", "--steps", "1", "--fewest-events", "0"]
    assert main(words) == 0, capsys.readouterr().err
    told = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in told] == [1]
    assert told[0]["loss"] == pytest.approx(np.log(2), abs=1e-3)  # policy and reference are the same before the step
    assert (tmp_path / "run" / "model.safetensors").exists()
