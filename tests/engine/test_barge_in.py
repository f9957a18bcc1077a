"""`clear(heard)`: what follows is what would have followed had the forgotten audio never come."""

from pathlib import Path

import numpy as np
import pytest
import torch

from echoavatar.engine import Delivery, Engine, Session, SessionCore
from echoavatar.engine.pipeline import Action, ActionLibrary, Pipeline, load_bundle
from echoavatar.engine.playout import first_frame_after
from echoavatar.models.generator.config import Opening
from echoavatar_lab.models.generator.model import Generator


@pytest.fixture(scope="module", params=[2, 3], ids=["8 frames", "12 frames"])
def pipeline(tiny_bundle: Path, request: pytest.FixtureRequest) -> Pipeline:
    """Our own step, and the release's of three tokens, which a generator of the paper's order takes."""
    bundle = load_bundle(tiny_bundle)
    if request.param == 3:
        opening = Opening(silence=(1, 2), motion=3)
        own = bundle.generator.config.model_copy(update={"sequence": "prefix", "step": 3, "opening": opening})
        torch.manual_seed(1)
        bundle = bundle.having(generator=Generator(own).eval())
    return Pipeline(bundle, precision="float32")


def noise(samples: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=samples).astype(np.float32) * 0.1


def row(engine: Engine, session: SessionCore) -> list[np.ndarray]:
    return [tensor[session.seat].copy() for tensor in engine._rows.state.arrays()]


class Player:
    """What a client shows: frames by number, the latest word counts."""

    def __init__(self, session: SessionCore) -> None:
        self.session, self.epoch = session, 0
        self.rotations: dict[int, np.ndarray] = {}

    def read(self) -> list[Delivery]:
        came = []
        while (delivery := self.session.take()) is not None:
            first = delivery.start // 800
            if delivery.epoch != self.epoch:
                self.rotations = {at: r for at, r in self.rotations.items() if at < first}
                self.epoch = delivery.epoch
            for frame, rotation in enumerate(delivery.motion.rotations):
                assert first + frame not in self.rotations, "a frame came twice"
                self.rotations[first + frame] = rotation
            came.append(delivery)
        return came

    def fastest(self) -> float:
        """Greatest turn of a joint from frame to frame, degrees per second."""
        assert sorted(self.rotations) == list(range(len(self.rotations))), "frames are missing"
        shown = np.stack([self.rotations[at] for at in range(len(self.rotations))])
        dots = np.abs((shown[1:] * shown[:-1]).sum(-1)).clip(0, 1)
        return float(np.degrees(2 * np.arccos(dots)).max() * 30)


def interrupted(
    engine: Engine, cuts: int, seed: int, *, chunk_s: float = 1.2, neighbour: SessionCore | None = None
) -> tuple[SessionCore, Player, np.ndarray]:
    """A session whose source runs far ahead and is interrupted `cuts` times at random; and the audio that counted."""
    random = np.random.default_rng(seed)
    session = engine.open_core(seed=7)
    player, truth = Player(session), np.zeros(0, np.float32)
    for cut in range(cuts):
        new = noise(int(random.uniform(0.3, chunk_s) * 24_000), seed=100 * seed + cut)
        session.push(new)
        truth = np.concatenate([truth, new])
        if neighbour is not None:
            neighbour.push(noise(random.integers(100, 9_000), cut))
        for _ in range(random.integers(0, 7)):
            engine.tick()
        if random.random() < 0.7:
            player.read()
        lowest = max(0, session.made - 9 * engine.chunk.samples)
        heard = int(random.integers(lowest, session.made + 1))
        heard = min(heard, len(truth))
        start = session.interrupt(heard).at
        assert start == first_frame_after(heard) * 800
        truth = truth[:heard]
        player.read()
    session.push(noise(30_000, seed=99))
    truth = np.concatenate([truth, noise(30_000, seed=99)])
    while session.is_ready:
        engine.tick()
    player.read()
    return session, player, truth


@pytest.mark.parametrize("seed", [1, 2])
def test_the_state_is_that_of_a_session_that_never_heard_it(pipeline: Pipeline, seed: int) -> None:
    """Twelve interruptions; every number of the model's state is compared, and no frame is missing or double."""
    engine = Engine(pipeline, seats=2)
    neighbour = engine.open_core(seed=3)
    session, player, truth = interrupted(engine, 12, seed, neighbour=neighbour)
    alone = Engine(pipeline, seats=2, rewind=0)
    alone.open_core(seed=3)
    witness = alone.open_core(seed=7)
    witness.push(truth)
    while witness.is_ready:
        alone.tick()
    size = pipeline.chunk.samples
    assert witness.made == session.made == len(truth) // size * size
    for own, other in zip(row(engine, session), row(alone, witness), strict=True):
        assert np.array_equal(own, other)
    assert player.fastest() < 1_000


def test_after_the_blend_the_motion_is_that_of_a_session_that_never_heard_it(pipeline: Pipeline) -> None:
    """Cut in the middle of the third chunk; from a second later on frames are the same."""
    engine, size, frames = Engine(pipeline), pipeline.chunk.samples, pipeline.chunk.frames
    session = engine.open_core(seed=1)
    session.push(noise(size * 6, 1))
    before = list(Session(session))
    start = session.interrupt(size * 2 + 3_000).at
    assert start == size * 2 + 3_200
    cut = 2 * frames + 4
    session.push(noise(size * 8, 2))
    after = list(Session(session))
    assert len(after[0].root) == frames - 4
    witness = Engine(pipeline).open_core(seed=1)
    witness.push(noise(size * 6, 1)[: size * 2 + 3_000])
    witness.push(noise(size * 8, 2))
    truth = np.concatenate([chunk.rotations for chunk in Session(witness)])
    shown = np.concatenate([chunk.rotations for chunk in after])
    np.testing.assert_array_equal(shown[30:], truth[cut + 30 :][: len(shown) - 30])
    assert not np.allclose(shown[:2], truth[cut : cut + 2], atol=1e-3)  # the blend is at work
    going = 2 * before[2].rotations[3] - before[2].rotations[2]  # where the old motion went
    assert np.abs(shown[0] - going).mean() < np.abs(truth[cut] - going).mean()


@pytest.mark.parametrize(("chunks", "more"), [(0, 0), (0, 1), (0, 800), (1, -1), (1, 0), (1, -799), (1, -399), (2, 0)])
def test_every_frame_after_the_cut_comes_once(pipeline: Pipeline, chunks: int, more: int) -> None:
    """At the border, one sample off, and where one frame or none of the chunk is left."""
    engine, size = Engine(pipeline), pipeline.chunk.samples
    heard = chunks * size + more
    session = engine.open_core()
    session.push(noise(2 * size, 1))
    player = Player(session)
    while session.is_ready:
        engine.tick()
    player.read()
    start = session.interrupt(heard).at
    session.push(noise(20_000, 2))
    while session.is_ready:
        engine.tick()
    first = player.read()[0]
    assert (first.start, first.epoch) == (start, 1)
    assert len(player.rotations) == (heard + 20_000) // size * pipeline.chunk.frames
    assert player.fastest() < 1_000


def test_a_clear_while_a_chunk_is_being_made_takes_that_chunk_back(pipeline: Pipeline) -> None:
    engine, size = Engine(pipeline), pipeline.chunk.samples
    session = engine.open_core(seed=4)
    session.push(noise(size * 4, 1))
    engine.tick()
    whole = engine.pipeline.step

    def interrupt(*given: object, **more: object) -> object:
        made = whole(*given, **more)  # type: ignore[arg-type]
        session.interrupt(5_000)
        session.push(noise(2 * size - 3_800, 2))
        return made

    engine.pipeline.step = interrupt  # type: ignore[assignment, method-assign]
    try:
        engine.tick()
    finally:
        del engine.pipeline.step
    while session.is_ready:
        engine.tick()
    alone = Engine(pipeline)
    witness = alone.open_core(seed=4)
    witness.push(np.concatenate([noise(size * 4, 1)[:5_000], noise(2 * size - 3_800, 2)]))
    while witness.is_ready:
        alone.tick()
    assert session.made == witness.made == 2 * size
    for own, other in zip(row(engine, session), row(alone, witness), strict=True):
        assert np.array_equal(own, other)


def test_look_ahead_is_bounded_by_the_player_or_else_by_the_reader(pipeline: Pipeline) -> None:
    engine, size = Engine(pipeline, look_ahead=3), pipeline.chunk.samples
    session = engine.open_core()
    session.push(noise(size * 12, 1))
    moved = sum(engine.tick() for _ in range(8))
    assert moved == 3
    assert session.take() is not None
    assert sum(engine.tick() for _ in range(8)) == 1
    session.report_played(size * 4)
    assert sum(engine.tick() for _ in range(8)) == 3
    assert session.made == 7 * size


def test_going_back_further_than_is_remembered_goes_as_far_as_it_can(pipeline: Pipeline) -> None:
    engine, size = Engine(pipeline, rewind=2), pipeline.chunk.samples
    session = engine.open_core()
    session.push(noise(size * 5, 1))
    assert len(list(Session(session))) == 5
    assert session.interrupt(0).at == 3 * size


def test_music_is_rewound_with_the_session(pipeline: Pipeline) -> None:
    """The same music goes out again from the cut on, and the avatar hears it."""
    tune = noise(24_000 * 4, 5)
    engine, size = Engine(pipeline), pipeline.chunk.samples
    session = engine.open_core()
    session.play("tune", tune)
    for _ in range(4):
        engine.tick()
    session.interrupt(size + 1_600)
    for _ in range(3):
        engine.tick()
    came = []
    while (delivery := session.take()) is not None:
        came.append(delivery)
    assert [delivery.epoch for delivery in came] == [0, 0, 1, 1, 1] or came[0].epoch == 0
    music = {d.start: d.music for d in came}
    np.testing.assert_array_equal(music[size + 1_600], tune[size + 1_600 : 2 * size])
    assert {d.source for d in came} == {"music"}


def test_an_action_does_not_wait_behind_motion_made_ahead(pipeline: Pipeline) -> None:
    """Ten chunks were made; the player is in the second. The action begins in the fourth, and no audio is lost."""
    engine, size = Engine(pipeline, look_ahead=12), pipeline.chunk.samples
    engine.actions = ActionLibrary({"bow": Action("bow", (5, 6, 7, 5, 5, 5), (0, 1), chunk=pipeline.chunk)})
    session = engine.open_core()
    session.push(noise(size * 10, 1))
    while session.is_ready:
        engine.tick()
    session.report_played(size + 1_600)
    assert session.act("nothing of that name").status == "rejected"
    assert session.made == 10 * size
    assert session.act("bow").at == 3 * size == session.made
    while session.is_ready:
        engine.tick()
    assert session.made == 10 * size
    assert [status.status for status in session.take_statuses()] == ["rejected", "accepted", "started", "done"]
    assert {session.take().source for _ in range(3)} == {"speech"}  # type: ignore[union-attr]
    assert session.take().source == "action"  # type: ignore[union-attr]
