"""Which test notices a wrong constant? Each constant that a user sees or hears is made 5 times larger, or smaller.

    python scripts/mutate_constants.py                       # all constants, 5 times larger
    python scripts/mutate_constants.py --down                # 5 times smaller
    python scripts/mutate_constants.py --only STIFFNESS      # one constant, or those of a folder: --only motion/stages

The constant is changed in a temporary copy of the package, and the tests nearest to it run against the copy. A row
shows its value, the changed value, and the first test that failed, or SURVIVED: then a test of what the constant does
is missing. The exit status is 1 if a constant survived, or if the tests fail without a change. Kernels are cached in
the copy, under names that cover their constants (`echoavatar.nn.kernels`).

`CONSTANTS` names a module's constant, `Class.field` for a default, `NAME[1]` for an element of a tuple. `:share` is
0 to 1 and comes five times closer to 1 where it cannot grow; `:dB` changes by 14 dB, five times the amplitude. Tests
are the file's own (`motion/gaze`: `tests/motion/test_gaze.py`), or those after `|`.
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
FACTOR, DECIBELS = 5.0, 14.0

CONSTANTS = {  # by file of the package
    "motion/stages/smoother": "STIFFNESS BEND:share LATE FASTEST",
    "motion/stages/stillness": "STILL_HZ GAIN_HZ LEAK:share AVERAGE_S CATCH_UP TRAVEL TRAVEL_S",
    "motion/stages/carriage": "HIPS LEANS RISES FORWARD HANGING",
    "motion/stages/feet": "ENTER_HEIGHT LEAVE_HEIGHT LEAVE_SPEED FADE:share SETTLE:share LARGEST LARGEST_ON_LEASH BACK"
    " STANDING_SPEED STEPPING_SPEED CLEARANCE CLEAR RISE:share | motion/stages/test_feet motion/stages/test_modes",
    "motion/stages/ground": "RELEASE_HEIGHT",
    "motion/stages/leash": "NEAR:share EDGE:share PULL_SPEED LEAN",
    "motion/stages/modes": "STAND_LOWER SWAY SWAY_SECONDS[0] SWAY_SECONDS[1] RAMP_FRAMES",
    "motion/ik/hand_collisions": "CLEARANCE SHELL",
    "motion/inertial": "SHORTEST_S LONGEST_S FASTEST GREATEST_START ROOT_FASTEST FACE_SECONDS",
    "motion/expression": "RISE_S FALL_S SPEAKING_JAW LIPS_KEPT:share",
    "motion/gaze": "RISE_S FALL_S HEAD_SHARE:share NECK_SHARE:share FARTHEST WELCOME BEHIND LOOK GLANCES:share",
    "motion/idle_motion": "BREATH BREATH_S INHALE:share SHIFT_EVERY_S SHIFT_S WAITING_M TALKING_M PAST_M NARROW_M"
    " FOLLOWS_S LEAN_EVERY_S LEAN_S UPRIGHT:share LEAN SWAY_M LOOK_EVERY_S LOOK_S AHEAD:share LOOKS PAUSES_S"
    " RISE_S FALL_S",
    "engine/settling": "STANDING DANCES DANCES_S RECENT_S AGAIN_S RESTING DANCE_RESTS_S TALK_RESTS_S",
    "engine/listener": "SOUND_DB:dB OVER_FLOOR_DB PAUSE_S TURN_S LEAST_SPEECH_S LEAST_GAP_S NOD_S NOD_SHARE:share",
    "engine/music": "DUCKED:share DUCK_S FADE_S AUDIBLE HOLD_FRAMES",
    "engine/pacing": "MARGIN_S PATIENCE_S | engine/test_pacing server/test_session",
    "engine/playout": "COASTING:share",
    "engine/session_core": "LISTEN_S MUSIC_AHEAD_S REPLAN_AHEAD_S | engine/test_session_core engine/test_listener",
    "engine/action_scheduler": "STRONGEST EDGE_S",
    "engine/audio_queue": "QUEUE_SECONDS MAX_UTTERANCES | engine/test_audio_queue engine/test_session",
    "engine/engine": "REWIND_S | engine/test_session_core",
    "engine/pipeline/pipeline": "BIAS LEARNED_BIAS",
    "engine/pipeline/runtime": "Runtime.lead_in_s | engine/pipeline/test_pipeline",
    "engine/pipeline/actions": "REACH_S LONGEST_S",
    "models/generator/config": "GeneratorConfig.temperature GeneratorConfig.top_p:share"
    " | lab/tests/models/generator/test_stream",
    "models/audio/level": "_TARGET_DB:dB _DECAY_DB _FLOOR_RISE_DB _FAINTEST_DB:dB _SURELY_SOUND_DB:dB _ABOVE_FLOOR_DB"
    " _HOLD_BLOCKS _GATE_STEP_DB _GATE_DB _KNEE:share",
    "models/face/idle": "_BLINK_EVERY _BLINKS:share _DOUBLES:share _GAZE_EVERY _GAZE_HOME:share _GAZE_YAW _GAZE_PITCH"
    " _GAZE_FRAMES _RISE:share _FALL:share _FAST:share _SLOW:share _FAINTEST_DB",
    "server/session": "KEPT_S",
    "server/outbox": "MOST_MOTION_S MOST_SOUND_S MOST_OTHER",
    "server/settings": "ServerSettings.ahead_seconds ServerSettings.inbox_seconds ServerSettings.resume_seconds"
    " | server/test_session server/test_session_manager",
    "server/sinks/player": "CORRECTION_S JUMP_S LEAD_S",
    "server/video/live_stream": "FAR_S MOST_AHEAD_S MOST_BEHIND_S",
    "agents/integrations/bridge": "LEAD_S",
    "agents/integrations/playback": "GRACE_S REST_S",
    "agents/proxy/speech_items": "STALL_S",
    "agents/client/utterances": "AHEAD_S | agents/client/test_connection",
}


class Constant(NamedTuple):
    """A constant and the tests nearest to it."""

    file: str
    name: str
    kind: str
    tests: list[str]

    def changed(self, value: float, *, down: bool) -> float:
        """Five times the value, or a fifth of it."""
        if self.kind == "dB":
            return value + (-DECIBELS if down else DECIBELS)
        changed = value / FACTOR if down else value * FACTOR
        if self.kind == "share" and changed > 1:
            changed = 1 - (1 - value) / FACTOR
        return round(changed) if isinstance(value, int) else changed


def constants() -> Iterator[Constant]:
    """The rows of `CONSTANTS`, one by one."""
    for file, row in CONSTANTS.items():
        names, _, tests = row.partition("|")
        paths = [f"{path}.py" for path in tests.split() or ["/test_".join(file.rsplit("/", 1))]]
        paths = [path if path.startswith("lab/") else f"tests/{path}" for path in paths]
        for word in names.split():
            name, _, kind = word.partition(":")
            yield Constant(file, name, kind, paths)


def values(tree: ast.Module) -> dict[str, ast.expr]:
    """The expressions that give constants, defaults of classes and elements of tuples their values, by name."""
    found: dict[str, ast.expr] = {}
    classes = ((f"{node.name}.", node.body) for node in tree.body if isinstance(node, ast.ClassDef))
    for prefix, body in (("", tree.body), *classes):
        for node in body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
                found[prefix + ast.unparse(target)] = node.value
                for place, element in enumerate(getattr(node.value, "elts", ())):
                    own = target.elts[place] if isinstance(target, ast.Tuple) else None
                    found[ast.unparse(own) if own else f"{ast.unparse(target)}[{place}]"] = element
    return found


def mutated(constant: Constant, *, down: bool) -> tuple[str, str, str]:
    """The source with the constant changed, and the constant before and after."""
    source = (PACKAGE / f"{constant.file}.py").read_text(encoding="utf-8")
    if (place := values(ast.parse(source)).get(constant.name)) is None:
        raise SystemExit(f"{constant.file} has no {constant.name} any more: bring CONSTANTS up to date")
    if isinstance(place, ast.Call):  # Field(default=...), math.radians(...)
        place = next((word.value for word in place.keywords if word.arg == "default"), place)
    is_angle = isinstance(place, ast.Call) and ast.unparse(place.func) == "math.radians"
    place = place.args[0] if is_angle else place  # type: ignore[attr-defined]
    was = ast.unparse(place)
    try:
        value = eval(was, {"__builtins__": {}})  # arithmetic such as 5 / 1024, from our own source
        became = repr(constant.changed(float(value) if is_angle else value, down=down))
    except NameError:  # an array
        became = f"{1 / FACTOR if down else FACTOR} * {was}"
    lines = source.splitlines(keepends=True)
    first, last = place.lineno - 1, (place.end_lineno or 0) - 1
    lines[first : last + 1] = [lines[first][: place.col_offset] + became + lines[last][place.end_col_offset :]]
    return "".join(lines), was, became


def copied(source: str, target: str) -> None:
    """A file of the copy: sources are copied, data are linked."""
    shutil.copy2(source, target) if source.endswith(".py") else os.symlink(source, target)


def run_tests(copy: Path, tests: list[str]) -> str:
    """Run tests against a copy; returns the first that failed, '' if all passed."""
    command = [sys.executable, "-m", "pytest", *tests, "-x", "-rfE", "-p", "no:cacheprovider", "--tb=no"]
    path = os.pathsep.join([str(copy), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)
    for line in done.stdout.splitlines():
        if line.startswith(("FAILED ", "ERROR ")):
            return line.partition(" - ")[0].replace("FAILED tests/", "")
    return "" if done.returncode == 0 else f"ERROR {(done.stdout + done.stderr).strip()[-200:]}"


def main() -> int:
    """Try the constants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--down", action="store_true", help="5 times smaller")
    parser.add_argument("--only", default="", metavar="TEXT", help="constants whose file or name contains this text")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="constants tried at once (default: 1)")
    asked = parser.parse_args()
    chosen = [constant for constant in constants() if asked.only in f"{constant.file} {constant.name}"]
    if not chosen:
        parser.error(f"no constant contains {asked.only!r}")
    changes = [mutated(constant, down=asked.down) for constant in chosen]
    with tempfile.TemporaryDirectory() as folder:
        copies: queue.Queue[Path] = queue.Queue()
        for number in range(asked.jobs):
            copies.put(Path(folder) / str(number))
            target = copies.queue[-1] / "echoavatar"
            shutil.copytree(PACKAGE, target, copy_function=copied, ignore=shutil.ignore_patterns("__pycache__"))
        if failed := run_tests(copies.queue[0], list(dict.fromkeys(path for each in chosen for path in each.tests))):
            print(f"without any change: {failed}")
            return 1

        def attempt(constant: Constant, change: tuple[str, str, str]) -> bool:
            copy, (text, was, became) = copies.get(), change
            target = copy / "echoavatar" / f"{constant.file}.py"
            target.write_text(text, encoding="utf-8")
            failed = run_tests(copy, constant.tests)
            shutil.copy2(PACKAGE / f"{constant.file}.py", target)
            copies.put(copy)
            place = f"{constant.file} {constant.name}"
            print(f"{place:<50}  {was[:10]:<10}  {became[:10]:<10}  {failed or 'SURVIVED'}", flush=True)
            return bool(failed) and not failed.startswith("ERROR")

        with ThreadPoolExecutor(asked.jobs) as pool:
            caught = list(pool.map(attempt, chosen, changes))
    print(f"{sum(caught)} of {len(caught)} constants are noticed")
    return 0 if all(caught) else 1


if __name__ == "__main__":
    sys.exit(main())
