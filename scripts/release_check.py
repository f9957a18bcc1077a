"""`make release-check`: build every distribution, check its metadata, install it alone, try it outside the checkout.

    python scripts/release_check.py [--only NAME ...] [--work FOLDER] [--python PROGRAM]

Each distribution gets a virtual environment of its own with nothing but its wheel and what that names. The table at
the end gives size, seconds and versions; the exit code is 1 if anything failed. pip and npm need the network, and
nothing is uploaded.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import venv
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
TOOLS = ("build>=1.2", "twine>=6", "pyroma>=5")
SOUND = ROOT / "src/echoavatar/assets/speech.ogg"
# What only the owner can give, and pyroma misses until then.
OWED = ("author-email",)


class Distribution(NamedTuple):
    """A package, the command lines that show that it works, and the distributions beside it that it needs."""

    name: str
    folder: str
    tries: tuple[str, ...]
    needs: tuple[str, ...] = ()
    extras: str = ""


_MAIN = (
    "echoavatar --version",
    "echoavatar doctor",
    "python -c \"import echoavatar; echoavatar.animate('speech.ogg').save('speech.bvh')\"",
    f"python {ROOT / 'scripts/try_avatar.py'} speech.ogg",
)
DISTRIBUTIONS = (
    Distribution("echoavatar", ".", _MAIN, extras="serve,mcp"),
    Distribution("echoavatar-studio", "studio", ("echoavatar studio --help",), ("echoavatar", "echoavatar-lab")),
    Distribution(
        "echoavatar-lab", "lab", ("echoavatar train --help", "echoavatar evaluate default --help"), ("echoavatar",)
    ),
    Distribution(
        "pipecat-echoavatar",
        "integrations/pipecat-echoavatar",
        ('python -c "import pipecat_echoavatar"',),
        ("echoavatar",),
    ),
    Distribution(
        "livekit-plugins-echoavatar",
        "integrations/livekit-plugins-echoavatar",
        ('python -c "import livekit.plugins.echoavatar"',),
        ("echoavatar",),
    ),
)
PACKAGES = ("web/packages/client",)  # of npm


class Row(NamedTuple):
    """A line of the table."""

    name: str
    version: str
    wheel_mb: float
    installed_mb: float
    seconds: float
    problems: list[str]


def main() -> int:
    """Check what was asked for and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these distributions (default: all, and npm)")
    parser.add_argument("--work", type=Path, help="keep what is built there (default: a temporary folder)")
    parser.add_argument("--python", default=sys.executable, help="the Python to install on (default: this one)")
    args = parser.parse_args()
    wanted = set(args.only or [each.name for each in DISTRIBUTIONS] + ["npm"])
    with tempfile.TemporaryDirectory() as temporary:
        work = (args.work or Path(temporary)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        tools = make_environment(work / "tools", sys.executable)
        say("tools", run([tools / "pip", "install", "-q", *TOOLS]))
        asked = {each.name for each in DISTRIBUTIONS if each.name in wanted}
        needed = {name for each in DISTRIBUTIONS if each.name in asked for name in each.needs}
        built = {each.name: build(each, tools, work) for each in DISTRIBUTIONS if each.name in asked | needed}
        rows = [check(each, tools, work, built, args.python) for each in DISTRIBUTIONS if each.name in asked]
        if "npm" in wanted:
            rows += [check_npm(ROOT / folder, work) for folder in PACKAGES]
    print(f"\n{'distribution':<28}{'version':<10}{'packed MB':>10}{'installed MB':>14}{'seconds':>9}  problems")
    for row in rows:
        numbers = f"{row.wheel_mb:>10.2f}{row.installed_mb:>14.0f}{row.seconds:>9.0f}"
        print(f"{row.name:<28}{row.version:<10}{numbers}  {'; '.join(row.problems) or 'none'}")
    print(f"before publishing the owner must add: {', '.join(OWED)}, and the repository's address. Then, with tokens:")
    print("    twine upload WORK/dist/*/*\n    npm publish --access public WORK/npm-client/*.tgz")
    return 1 if any(row.problems for row in rows) else 0


def build(each: Distribution, tools: Path, work: Path) -> list[Path]:
    """The wheel and the source archive; the wheel is built from the archive, so that the archive is whole."""
    out = work / "dist" / each.name
    shutil.rmtree(out, ignore_errors=True)
    say(f"build {each.name}", run([tools / "python", "-m", "build", "-o", out, ROOT / each.folder]))
    return sorted(out.iterdir(), key=lambda path: path.suffix != ".whl")


def check(each: Distribution, tools: Path, work: Path, built: dict[str, list[Path]], python: str) -> Row:
    """Metadata, and a clean environment."""
    began, problems, files = time.monotonic(), list[str](), built[each.name]
    if not files:
        return Row(each.name, "?", 0, 0, 0, ["does not build"])
    problems += failed("twine", run([tools / "twine", "check", "--strict", *files]))
    said = run([tools / "pyroma", files[-1]]).stdout
    lacks = [line for line in said.splitlines() if line.startswith(("Your", "The", "You")) and line.endswith(".")]
    problems += [line for line in lacks if not any(owed in line for owed in OWED)]
    environment = make_environment(work / f"env-{each.name}", python)
    wheels = [str(built[name][0]) for name in (*each.needs, each.name)]
    wheels[-1] += f"[{each.extras}]" if each.extras else ""
    problems += failed("install", run([environment / "pip", "install", "-q", "-c", ROOT / "constraints.txt", *wheels]))
    folder = work / f"try-{each.name}"
    folder.mkdir(exist_ok=True)
    shutil.copy(SOUND, folder / "speech.ogg")
    for words in each.tries:
        problems += failed(words, run(words, folder=folder, first=environment))
    site = next(environment.parent.glob("lib/python*/site-packages"), environment.parent)
    version = files[0].name.split("-")[1]
    return Row(each.name, version, megabytes(files[0]), megabytes(site), time.monotonic() - began, problems)


def check_npm(folder: Path, work: Path) -> Row:
    """Pack, unpack, and import in Node from a project that has only the tarball and its peers."""
    began, problems = time.monotonic(), list[str]()
    project = work / f"npm-{folder.name}"
    shutil.rmtree(project, ignore_errors=True)
    project.mkdir()
    problems += failed("npm ci", run(["npm", "ci", "--no-audit", "--no-fund"], folder=ROOT / "web"))
    packed = run(["npm", "pack", "--pack-destination", project, "--json"], folder=folder)
    problems += failed("npm pack", packed)
    manifest = json.loads((folder / "package.json").read_text("utf-8"))
    if problems:
        return Row(manifest["name"], manifest["version"], 0, 0, time.monotonic() - began, problems)
    tarball = next(project.glob("*.tgz"))
    with tarfile.open(tarball) as archive:
        names = archive.getnames()
    wrong = [name for name in names if "/test/" in name]
    problems += [f"packs {wrong[0]}"] if wrong else []
    (project / "package.json").write_text('{"private": true, "type": "module"}', "utf-8")
    peers = [f"{name}@{version}" for name, version in manifest.get("peerDependencies", {}).items()]
    problems += failed(
        "npm install", run(["npm", "install", "--no-audit", "--no-fund", tarball, *peers], folder=project)
    )
    doors = [door for door in manifest["exports"] if "*" not in door]
    code = "\n".join(f"await import('{manifest['name']}{door[1:]}');" for door in doors)
    problems += failed("import", run(["node", "--input-type=module", "-e", code], folder=project))
    problems += failed("publint", run(["npx", "publint", "run", tarball, "--strict"], folder=ROOT / "web"))
    size = megabytes(project / "node_modules")
    return Row(manifest["name"], manifest["version"], megabytes(tarball), size, time.monotonic() - began, problems)


def make_environment(folder: Path, python: str) -> Path:
    """A new virtual environment; returns its folder of programs."""
    shutil.rmtree(folder, ignore_errors=True)
    if python == sys.executable:
        venv.create(folder, with_pip=True)
    else:
        subprocess.run([python, "-m", "venv", folder], check=True)
    return folder / ("Scripts" if os.name == "nt" else "bin")


def run(
    command: "list[object] | str", *, folder: Path | None = None, first: Path | None = None
) -> "subprocess.CompletedProcess[str]":
    """Run in a clean environment: no PYTHONPATH, and the programs of `first` before all others."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    if first is not None:
        environment["PATH"] = f"{first}{os.pathsep}{environment['PATH']}"
    words = command if isinstance(command, str) else [str(word) for word in command]
    return subprocess.run(
        words, shell=isinstance(command, str), cwd=folder, env=environment, capture_output=True, text=True
    )


def failed(what: str, done: "subprocess.CompletedProcess[str]") -> list[str]:
    """Nothing, or one line about the failure."""
    say(what, done)
    if not done.returncode:
        return []
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    return [f"{what[:40]}: {lines[-1][:160] if lines else f'exit code {done.returncode}'}"]


def say(what: str, done: "subprocess.CompletedProcess[str]") -> None:
    """Tell the progress."""
    print(f"  {'ok' if not done.returncode else 'FAILED'}  {what}", flush=True)
    if done.returncode:
        print((done.stdout + done.stderr)[-2000:], flush=True)


def megabytes(path: Path) -> float:
    """The size of a file or of all files in a folder."""
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file() and not file.is_symlink()]
    return sum(file.stat().st_size for file in files) / 1e6


if __name__ == "__main__":
    sys.exit(main())
