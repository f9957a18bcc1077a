"""Which test notices a wrong constant? Each constant that a user sees or hears is made 5 times larger, or smaller.

    python scripts/mutate_constants.py                       # all constants, 5 times larger
    python scripts/mutate_constants.py --down                # 5 times smaller
    python scripts/mutate_constants.py --only STIFFNESS      # one constant, or those of a file: --only motion/stages

The package is copied to a temporary folder, one constant is changed in the copy, and the tests nearest to it run
against the copy. The checkout is never changed. A row is printed for each constant: its value, the changed value, and
the first test that failed, or SURVIVED. A constant that survives needs a test of what it does. The exit status is 1 if
a constant survived, or if the tests fail without any change.

The tests are those of the default run. Compiled kernels are cached in each copy, under names that cover the constants
they use (`echoavatar.nn.kernels`), so the kernels of one constant are never taken for those of another.

To add a constant, add a row to `CONSTANTS`. A name is a module's constant, `Class.field` for a default, or `NAME[1]`
for an element of a tuple.
"""

import argparse
import ast
import os
import queue
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "echoavatar"
FACTOR = 5.0
DECIBELS = 14.0  # five times the amplitude
WIDTHS = (52, 10, 10)  # columns of the table


class Constant(NamedTuple):
    """A constant and the tests nearest to it."""

    file: str  # in the package
    name: str
    tests: str  # paths in `tests`, with spaces between them
    kind: str = ""  # or "share", whose distance from 1 shrinks if it cannot grow; or "dB"

    def changed(self, value: float, *, down: bool) -> float:
        """Five times the value, or a fifth of it."""
        if self.kind == "dB":
            return value + (-DECIBELS if down else DECIBELS)
        changed = value / FACTOR if down else value * FACTOR
        if self.kind == "share" and changed > 1:
            return 1 - (1 - value) / FACTOR
        return round(changed) if isinstance(value, int) else changed


CONSTANTS = [
    Constant(file, name, tests, kind)
    for file, tests, names in (
        ("motion/stages/smoother.py", "motion/stages/test_smoother.py", "STIFFNESS BEND:share LATE FASTEST"),
        (
            "motion/stages/feet.py",
            "motion/stages/test_feet.py",
            "ENTER_HEIGHT LEAVE_HEIGHT LEAVE_SPEED FADE:share SETTLE:share LARGEST BACK STANDING_SPEED STEPPING_SPEED"
            " CLEARANCE CLEAR RISE:share",
        ),
        ("motion/stages/ground.py", "motion/stages/test_ground.py", "RELEASE_HEIGHT"),
        ("motion/stages/leash.py", "motion/stages/test_leash.py", "NEAR:share EDGE:share PULL_SPEED LEAN"),
        ("motion/stages/post.py", "motion/stages/test_modes.py", "LARGEST_ON_LEASH"),
        ("motion/stages/modes.py", "motion/stages/test_modes.py", "STAND_LOWER SWAY SWAY_SECONDS[0] RAMP_FRAMES"),
        ("motion/ik/hand_collisions.py", "motion/ik/test_hand_collisions.py", "CLEARANCE"),
        ("motion/ik/hand_shift.py", "motion/ik/test_hand_shift.py motion/ik/test_hand_collisions.py", "SHELL"),
        (
            "motion/inertial.py",
            "motion/test_inertial.py",
            "SHORTEST_S LONGEST_S FASTEST GREATEST_START ROOT_FASTEST FACE_SECONDS",
        ),
        ("motion/expression.py", "motion/test_expression.py", "RISE_S FALL_S SPEAKING_JAW LIPS_KEPT:share"),
        (
            "motion/gaze.py",
            "motion/test_gaze.py",
            "RISE_S FALL_S HEAD_SHARE:share NECK_SHARE:share FARTHEST WELCOME BEHIND LOOK GLANCES:share",
        ),
        (
            "motion/idle_motion.py",
            "motion/test_idle_motion.py",
            "BREATH BREATH_S INHALE:share SHIFT_EVERY_S SHIFT_S SHIFT_M LEAN_EVERY_S LEAN_S UPRIGHT:share LEAN SWAY_M"
            " LOOK_EVERY_S LOOK_S AHEAD:share LOOK_YAW LOOK_PITCH RISE_S FALL_S",
        ),
        ("engine/settling.py", "engine/test_settling.py", "SILENCE STANDING DANCES DANCES_S RECENT_S AGAIN_S"),
        (
            "engine/listener.py",
            "engine/test_listener.py",
            "SOUND_DB:dB OVER_FLOOR_DB PAUSE_S TURN_S LEAST_SPEECH_S LEAST_GAP_S NOD_S NOD_SHARE:share",
        ),
        ("engine/music.py", "engine/test_music.py", "DUCKED:share DUCK_S FADE_S AUDIBLE HOLD_FRAMES"),
        ("engine/playout.py", "engine/test_playout.py", "COASTING:share"),
        (
            "engine/session_core.py",
            "engine/test_session_core.py engine/test_listener.py",
            "LISTEN_S MUSIC_AHEAD_S REPLAN_AHEAD",
        ),
        ("engine/action_scheduler.py", "engine/test_action_scheduler.py", "STRONGEST"),
        ("engine/audio_queue.py", "engine/test_audio_queue.py engine/test_session.py", "QUEUE_SECONDS MAX_UTTERANCES"),
        ("engine/engine.py", "engine/test_session_core.py", "REWIND"),
        (
            "engine/pipeline/pipeline.py",
            "engine/pipeline/test_pipeline.py engine/pipeline/test_actions.py",
            "BIAS LEARNED_BIAS",
        ),
        (
            "engine/pipeline/runtime.py",
            "engine/pipeline/test_runtime.py engine/pipeline/test_warm_start.py",
            "Runtime.lead_in_s",
        ),
        ("engine/pipeline/actions.py", "engine/pipeline/test_actions.py", "REACH LONGEST_S"),
        (
            "models/generator/config.py",
            "models/generator/test_stream.py",
            "GeneratorConfig.temperature GeneratorConfig.top_p:share",
        ),
        (
            "models/audio/level.py",
            "models/audio/test_level.py",
            "_TARGET_DB:dB _DECAY_DB _FLOOR_RISE_DB _FAINTEST_DB:dB _SURELY_SOUND_DB:dB"
            " _ABOVE_FLOOR_DB _HOLD_BLOCKS _GATE_STEP_DB _GATE_DB _KNEE:share",
        ),
        (
            "models/face/idle.py",
            "models/face/test_idle.py",
            "_BLINK_EVERY _BLINKS:share _DOUBLES:share _GAZE_EVERY _GAZE_HOME:share _GAZE_YAW _GAZE_PITCH _GAZE_FRAMES"
            " _RISE:share _FALL:share _FAST:share _SLOW:share _FAINTEST_DB",
        ),
        ("server/session.py", "server/test_session.py server/test_session_manager.py", "MARGIN_S KEPT_S"),
        ("server/playhead.py", "server/test_playhead.py", "PATIENCE_S"),
        ("server/outbox.py", "server/test_outbox.py", "MOST_MOTION MOST_SOUND MOST_OTHER"),
        (
            "server/settings.py",
            "server/test_settings.py server/test_session.py server/test_session_manager.py",
            "ServerSettings.ahead_seconds ServerSettings.inbox_seconds ServerSettings.resume_seconds",
        ),
        ("server/session_manager.py", "server/test_session_manager.py", "BEAT_S"),
        ("server/sinks/clock.py", "server/sinks/test_clock.py", "CORRECTION_S JUMP_S EXTRAPOLATION_S"),
        ("server/sinks/sink_group.py", "server/sinks/test_sink_group.py", "LEAD_S"),
        ("server/video/live_stream.py", "server/video/test_live_stream.py", "FAR_S MOST_AHEAD_S MOST_BEHIND_S"),
        ("agents/integrations/bridge.py", "agents/integrations/test_bridge.py", "LEAD_S REPORT_S"),
        ("agents/integrations/playback.py", "agents/integrations/test_playback.py", "GRACE_S REST_S"),
        ("agents/integrations/elevenlabs.py", "agents/integrations/test_elevenlabs.py", "PAUSE_S"),
        ("agents/proxy/conversation.py", "agents/proxy/test_conversation.py", "GRACE_S"),
        ("agents/proxy/speech_items.py", "agents/proxy/test_speech_items.py", "STALL_S KEPT_CHUNKS"),
        ("agents/client/utterances.py", "agents/client/test_utterances.py", "AHEAD_S"),
        ("wire/sockets.py", "wire/test_sockets.py", "SILENCE_S"),
    )
    for name, _, kind in (word.partition(":") for word in names.split())
]


def place_of(source: str, name: str) -> ast.expr:
    """The expression that gives a constant its value.

    Raises:
        SystemExit: there is no such constant.
    """
    plain, _, index = name.removesuffix("]").partition("[")
    owner, _, field = plain.rpartition(".")
    body = ast.parse(source).body
    if owner:
        body = next((node.body for node in body if isinstance(node, ast.ClassDef) and node.name == owner), [])
    for target, value in assignments(body):
        if target == field:
            if isinstance(value, ast.Call) and not index:  # Field(default=...)
                value = next((word.value for word in value.keywords if word.arg == "default"), value)
            return value.elts[int(index)] if index and isinstance(value, ast.Tuple) else value
    raise SystemExit(f"no constant {name}: bring the table CONSTANTS up to date")


def assignments(body: list[ast.stmt]) -> Iterator[tuple[str, ast.expr]]:
    """Names and the expressions assigned to them; those of tuples one by one."""
    for node in body:
        if isinstance(node, ast.AnnAssign) and node.value is not None and isinstance(node.target, ast.Name):
            yield node.target.id, node.value
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            yield node.targets[0].id, node.value
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple):
            for target, value in zip(node.targets[0].elts, getattr(node.value, "elts", ()), strict=False):
                if isinstance(target, ast.Name):
                    yield target.id, value


def mutated(constant: Constant, *, down: bool) -> tuple[str, str, str]:
    """The source with the constant changed, and the constant before and after; angles keep their `math.radians`."""
    source = (PACKAGE / constant.file).read_text(encoding="utf-8")
    place = place_of(source, constant.name)
    if isinstance(place, ast.Call) and place.args and "radians" in ast.unparse(place.func):
        place = place.args[0]
    was = ast.unparse(place)
    try:
        became = repr(constant.changed(eval(was, {"__builtins__": {}}), down=down))
    except NameError:  # an array, or a constant made of others
        became = f"{1 / FACTOR if down else FACTOR} * ({was})"
    lines = source.splitlines(keepends=True)
    first, last = place.lineno - 1, (place.end_lineno or 0) - 1
    before, after = lines[first][: place.col_offset], lines[last][place.end_col_offset :]
    lines[first : last + 1] = [before + became + after]
    return "".join(lines), was, became


def make_copy(folder: Path) -> Path:
    """A copy of the package whose data are links; returns the folder for PYTHONPATH."""

    def take(source: str, target: str) -> None:
        shutil.copy2(source, target) if source.endswith(".py") else os.symlink(source, target)

    shutil.copytree(PACKAGE, folder / "echoavatar", copy_function=take, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def run_tests(copy: Path, tests: str) -> str:
    """Run tests against a copy; returns the first that failed, or '' if all passed."""
    paths = [f"tests/{path}" for path in tests.split()]
    command = [sys.executable, "-m", "pytest", *paths, "-x", "-rfE", "-p", "no:cacheprovider", "--tb=no"]
    path = os.pathsep.join([str(copy), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)
    for line in done.stdout.splitlines():
        if line.startswith(("FAILED ", "ERROR ")):
            return line.partition(" - ")[0].replace("FAILED tests/", "")
    return "" if done.returncode == 0 else f"ERROR {(done.stdout + done.stderr).strip()[-200:]}"


def main() -> int:
    """Try the constants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--down", action="store_true", help="5 times smaller instead of larger")
    parser.add_argument("--only", default="", metavar="TEXT", help="constants whose file or name contains this text")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="constants tried at once (default: 1)")
    parser.add_argument("--list", action="store_true", help="print values and changed values, run nothing")
    asked = parser.parse_args()
    chosen = [constant for constant in CONSTANTS if asked.only in f"{constant.file} {constant.name}"]
    if not chosen:
        raise SystemExit(f"no constant contains {asked.only!r}")
    if asked.list:
        for constant in chosen:
            show(constant, *mutated(constant, down=asked.down)[1:], constant.tests)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        copies: queue.Queue[Path] = queue.Queue()
        for number in range(asked.jobs):
            copies.put(make_copy(Path(folder) / str(number)))

        def attempt(constant: Constant) -> bool:
            text, was, became = mutated(constant, down=asked.down)
            copy = copies.get()
            target = copy / "echoavatar" / constant.file
            target.write_text(text, encoding="utf-8")
            failed = run_tests(copy, constant.tests)
            shutil.copy2(PACKAGE / constant.file, target)
            copies.put(copy)
            show(constant, was, became, failed or "SURVIVED")
            return bool(failed) and not failed.startswith("ERROR")

        unchanged = " ".join(dict.fromkeys(path for constant in chosen for path in constant.tests.split()))
        if failed := run_tests(Path(folder) / "0", unchanged):
            print(f"without any change: {failed}")
            return 1
        with ThreadPoolExecutor(asked.jobs) as pool:
            caught = list(pool.map(attempt, chosen))
    print(f"{sum(caught)} of {len(caught)} constants are noticed")
    return 0 if all(caught) else 1


def show(constant: Constant, was: str, became: str, found: str) -> None:
    """Print one row."""
    cells = [f"{constant.file.removesuffix('.py')} {constant.name}", was[:10], became[:10]]
    print("  ".join([*(cell.ljust(width) for cell, width in zip(cells, WIDTHS, strict=True)), found]), flush=True)


if __name__ == "__main__":
    sys.exit(main())
