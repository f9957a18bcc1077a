"""The release's own step, 12 frames for 9,600 samples, everywhere a session goes; its laws are in tests/engine."""

import asyncio
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import soundfile
from tests.server.fakes import serving

from echoavatar.bench import sessions as sessions_bench
from echoavatar.bench.face import bench_face
from echoavatar.bench.sessions import bench_sessions
from echoavatar.bench.stream import bench_stream
from echoavatar.cli import main
from echoavatar.engine import Engine, animate
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.wire.blobs import unpack_pose
from echoavatar.wire.messages import Flush, Hello, Interrupt, Motion, Sound
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.unity import UnitySettings, serve_unity

STEP = 9_600


@pytest.fixture(scope="module")
def pipeline(in_threes: Path) -> Pipeline:
    return Pipeline(load_bundle(in_threes))


def row(engine: Engine) -> list[np.ndarray]:
    return [tensor[0].copy() for tensor in engine._rows.state.arrays()]


def test_its_parts_step_alike(pipeline: Pipeline) -> None:
    """Three motion tokens, thirty audio frames, and a face whose past is four frames shorter than the paper's."""
    assert (pipeline.chunk.samples, pipeline.chunk.frames) == (STEP, 12)
    assert pipeline.face is not None
    assert (pipeline.face.config.step, pipeline.face.config.context) == (12, 52)
    assert pipeline.actions["stand"].seconds == pytest.approx(4.0)
    assert pipeline.actions["stand"].chunks == 10


@pytest.mark.parametrize(("imported_as", "seconds"), [("imported", 0.27), ("in_threes", 0.4)])
def test_a_step_is_as_long_as_the_page_says(
    imported_as: str, seconds: float, voice: np.ndarray, request: pytest.FixtureRequest
) -> None:
    """docs/reference.md: the motion that a session makes at once, 8 frames of 30 a second, or 12."""
    with Engine(Pipeline(load_bundle(request.getfixturevalue(imported_as)))).open() as session:
        session.push(voice[:24_000])
        assert {round(len(chunk.rotations) / 30, 2) for chunk in list(session)} == {seconds}


def test_a_session_gives_twelve_frames_and_goes_back_exactly(pipeline: Pipeline, voice: np.ndarray) -> None:
    """Cut within the third chunk: the model's state, and the motion once the blend has died away, are those of a
    session that never heard the rest."""
    engine = Engine(pipeline)
    session = engine.open(seed=2)
    session.push(voice[: 4 * STEP])
    made = list(session)
    assert [chunk.rotations.shape for chunk in made] == [(12, 52, 4)] * 4
    assert all(chunk.face is not None and chunk.face.shape == (12, 52) for chunk in made)
    assert session.clear(2 * STEP + 2_500) == 2 * STEP + 3_200
    session.push(voice[: 3 * STEP])
    after = list(session)
    assert len(after[0].root) == 8
    alone = Engine(pipeline, rewind=0)
    witness = alone.open(seed=2)
    witness.push(np.concatenate([voice[: 2 * STEP + 2_500], voice[: 3 * STEP]]))
    truth = np.concatenate([chunk.rotations for chunk in witness])[28:]
    assert session.status.made == witness.status.made == 5 * STEP
    for own, other in zip(row(engine), row(alone), strict=True):
        assert np.array_equal(own, other)
    shown = np.concatenate([chunk.rotations for chunk in after])
    np.testing.assert_array_equal(shown[24:], truth[24:])


@pytest.mark.parametrize("options", [MotionOptions(leash_m=0.5), MotionOptions(upper_body=True)], ids=str)
def test_what_is_asked_of_a_body_holds_for_longer_chunks_too(
    pipeline: Pipeline, voice: np.ndarray, options: MotionOptions
) -> None:
    with Engine(pipeline).open(options=options) as session:
        session.push(voice)
        root = np.concatenate([chunk.root for chunk in session])
    assert len(root) == 48_000 // STEP * 12
    assert np.linalg.norm(root[:, [0, 2]] - root[0, [0, 2]], axis=1).max() < 0.75


@pytest.mark.parametrize("kind", ["glb", "bvh"])
def test_files_are_as_long_as_their_sound(in_threes: Path, voice: np.ndarray, tmp_path: Path, kind: str) -> None:
    soundfile.write(tmp_path / "talk.wav", voice[:40_000], 24_000)
    out = tmp_path / f"talk.{kind}"
    assert main(["animate", str(tmp_path / "talk.wav"), "-o", str(out), "--model", str(in_threes)]) == 0
    if kind == "bvh":
        assert read_bvh(out).frames == 50
    else:
        data = out.read_bytes()
        (size,) = struct.unpack("<I", data[12:16])
        scene = json.loads(data[20 : 20 + size])
        times = scene["accessors"][scene["animations"][0]["samplers"][0]["input"]]
        assert times["count"] == 50


def test_the_server_says_how_long_its_chunks_are_and_sends_them(pipeline: Pipeline, voice: np.ndarray) -> None:
    """Motion without gaps in chunks of 12 frames; after an interruption from the first frame that was not heard on."""
    with serving(seats=1, pipeline=pipeline) as place, place.call(Hello()) as caller:
        assert caller.ready.chunk_samples == STEP
        assert caller.ready.latency.algorithm == pytest.approx(400)
        caller.speak(1, voice)
        caller.until(Sound, lambda sound: sound.at >= STEP)
        motion = [message for message in caller.heard if isinstance(message, Motion)]
        assert [message.at for message in motion] == [STEP * at for at in range(len(motion))]
        assert all(unpack_pose(message).rotations.shape == (12, 52, 4) for message in motion)
        assert all(len(message.pcm) == 2 * STEP for message in caller.heard if isinstance(message, Sound))
        caller.say(Interrupt(heard=4_000))
        assert caller.until(Flush).at == 4_000
        new = caller.until(Motion)
        assert (new.at, new.frames) == (4_000, 7)
        assert (caller.until(Motion).at, caller.heard[-1].epoch) == (STEP, 1)


async def test_unity_is_sent_whole_messages(in_threes: Path, voice: np.ndarray) -> None:
    """The published server's messages are 0.4 s long, so each is one chunk."""
    bundle = load_bundle(in_threes)
    got: list[dict[str, object]] = []
    done = asyncio.Event()

    async def unity(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while not done.is_set():
            (size,) = struct.unpack(">I", await reader.readexactly(4))
            got.append(json.loads(await reader.readexactly(size)))
            if len(got) == 2:
                done.set()
        writer.close()

    server = await asyncio.start_server(unity, "127.0.0.1", 0)
    ports = asyncio.get_running_loop().create_future()
    settings = UnitySettings(audio_port=0, action_port=0, unity_port=server.sockets[0].getsockname()[1])
    engine = Engine(Pipeline(bundle, output="native", stages=()), rewind=0)
    rig = bundle.runtime.rig
    assert rig is not None
    job = asyncio.create_task(serve_unity(engine, rig, settings, on_ready=lambda *own: ports.set_result(own)))
    audio_port, _ = await asyncio.wait_for(ports, 10)
    _, audio = await asyncio.open_connection("127.0.0.1", audio_port)
    for at in range(0, 24_000, 1_000):
        sound = _pickled(voice[at : at + 1_000])
        audio.write(struct.pack(">I", len(sound)) + sound)
    await audio.drain()
    await asyncio.wait_for(done.wait(), 20)
    job.cancel()
    await asyncio.gather(job, return_exceptions=True)
    audio.close()
    server.close()
    assert np.shape(got[0]["pose"]) == (24, 88, 4)
    np.testing.assert_allclose(np.array(got[1]["audio"]), voice[STEP : 2 * STEP], atol=1e-4)


@pytest.mark.slow
def test_benches_count_in_its_chunks(pipeline: Pipeline, in_threes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions_bench, "WARM_UP_CHUNKS", 1)
    report = bench_stream(pipeline, seconds=0.8)
    assert report.summary["seconds"] == pytest.approx(0.8)
    assert report.summary["first_motion_ms"] > 400
    (load,) = bench_sessions(pipeline, (1,), seconds=1.0)
    assert load.sessions == 1
    assert bench_face(load_bundle(in_threes).face.stream(), chunks=3, sessions=2)["face_ms_p50"] > 0


def test_several_files_at_once_are_the_same_as_one(pipeline: Pipeline, voice: np.ndarray) -> None:
    told: list[tuple[int, int]] = []
    sounds = [voice[:15_000], voice[:30_000]]
    made = animate_many(pipeline, sounds, seeds=[1, 2], progress=lambda *now: told.append(now))
    assert [one.motion.frames for one in made] == [19, 38]
    assert told[-1] == (6, 6)  # two chunks and four
    alone = animate(pipeline, [sounds[1]], seed=2)
    np.testing.assert_allclose(made[1].motion.rotations, alone.motion.rotations, atol=1e-4)


def _pickled(samples: np.ndarray) -> bytes:
    """As the authors' sender writes it."""
    import pickle  # noqa: TID251

    return pickle.dumps(samples.astype(np.float32).reshape(-1, 1))
