"""`echoavatar data rl-corpus`: speech and music without motion, for reinforcement learning. May import all below."""

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from echoavatar.cli.options import seed
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.progress import progress_bar

if TYPE_CHECKING:
    from echoavatar_lab.datasets.rl_corpus import Kind, RlCorpusResult

EXAMPLES = """examples:
  echoavatar data rl-corpus -o sounds                                   local voices, composed music
  echoavatar data rl-corpus -o sounds --hours 0.1 --pieces 5 --model default      also prompts, in sounds/tokens
  OPENAI_API_KEY=... echoavatar data rl-corpus -o sounds --tts openai --scripts talk.txt
  ELEVENLABS_API_KEY=... echoavatar data rl-corpus -o sounds --tts elevenlabs --voice ID --voice ID
  echoavatar data rl-corpus -o sounds --tts openai --tts-url http://localhost:8880/v1 --tts-model kokoro --voice af_sky
  echoavatar data rl-corpus -o sounds --music my_music --music-licence "CC BY 4.0, see my_music/README"
then, with a reference_statistics from a run on true motion:
  echoavatar align grpo sounds/tokens -o runs/grpo --reference-statistics runs/first/reference_statistics.json

Scripts are plain text: one turn per line, optionally with `Name: ` before it, and a blank line between scripts. After
the last one, shipped and generated scripts fill the hours. Keys are read from the environment and never written. The
same call continues an interrupted run. docs/alignment.md describes the folder.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="output folder")
    parser.add_argument("--seed", type=seed, default=0, help="seed of scripts, voices and music (default: %(default)s)")
    speech = parser.add_argument_group("speech")
    speech.add_argument("--hours", type=float, default=1.0, help="hours of speech; 0 for none (default: %(default)s)")
    speech.add_argument("--scripts", type=Path, metavar="FILE", help="scripts to speak first, UTF-8 text")
    speech.add_argument(
        "--scripts-licence", default="not stated", metavar="TEXT", help="licence of the scripts, for the manifest"
    )
    speech.add_argument(
        "--tts",
        choices=("auto", "flite", "own", "openai", "elevenlabs"),
        default="auto",
        help="flite, own (the built-in synthesiser), auto (flite if installed, else own), or a service with its key in"
        " OPENAI_API_KEY or ELEVENLABS_API_KEY (default: %(default)s)",
    )
    speech.add_argument("--tts-url", metavar="URL", help="another server with the same protocol, including /v1")
    speech.add_argument("--tts-model", metavar="NAME", help="model of the service (default: its usual one)")
    speech.add_argument(
        "--voice", action="append", default=[], metavar="NAME", help="voice of the service; may be repeated"
    )
    music = parser.add_argument_group("music")
    music.add_argument("--pieces", type=int, default=100, help="pieces of music; 0 for none (default: %(default)s)")
    music.add_argument("--music", type=Path, metavar="DIR", help="a folder of sound files (default: composed music)")
    music.add_argument("--music-licence", default="not stated", metavar="TEXT", help="its licence, for the manifest")
    after = parser.add_argument_group("afterwards")
    after.add_argument(
        "--model",
        help="also write DIR/tokens, prompts for `align`: codes by this bundle's codec, motion by its generator",
    )
    after.add_argument("--strict", action="store_true", help="exit with 1 if any recording failed")


def run(args: argparse.Namespace) -> int:
    """Make the sounds, report, tokenise."""
    from echoavatar_lab.datasets.rl_corpus import SoundPlan, make_rl_corpus
    from echoavatar_lab.datasets.text_to_speech import text_to_speech

    plan = SoundPlan(
        folder=args.output,
        voice=text_to_speech(args.tts, url=args.tts_url, model=args.tts_model, voices=args.voice),
        hours=args.hours,
        pieces=args.pieces,
        seed=args.seed,
        scripts=args.scripts,
        scripts_licence=args.scripts_licence,
        music=args.music,
        music_licence=args.music_licence,
    )
    try:
        with progress_bar() as say:
            found = make_rl_corpus(plan, say)
    except KeyboardInterrupt:
        print(f"finished recordings are in {plan.folder}; the same call continues from there")
        raise
    _print_result(found, args)
    if not found.made and not found.kept:
        raise EchoAvatarError(f"no recording could be made; the first failed: {': '.join(found.failures[0])}")
    if args.model:
        _write_tokens(args)
    for name, why in found.failures:
        print(f"failed: {name}  {why}")
    return 1 if args.strict and found.failures else 0


def _print_result(found: "RlCorpusResult", args: argparse.Namespace) -> None:
    kinds: tuple[Kind, ...] = ("speech", "music")
    for kind in kinds:
        sounds = found.sounds(kind)
        held_out = sum(sound.split == "test" for sound in sounds)
        print(f"{kind}: {len(sounds)} recordings, {found.seconds(kind) / 60:.1f} minutes, {held_out} held out")
    if args.music and len(found.sounds("music")) < args.pieces:
        print(f"{args.music} has fewer than the {args.pieces} pieces asked for")
    print(
        f"{len(found.made)} made, {len(found.kept)} kept, {len(found.failures)} failed; {args.output / 'sounds.json'}"
    )


def _write_tokens(args: argparse.Namespace) -> None:
    from echoavatar.engine.pipeline import load_bundle
    from echoavatar_lab.data import SoundSet
    from echoavatar_lab.models.tokenize import tokenize_sounds

    bundle, sounds = load_bundle(args.model), SoundSet(args.output)
    codec, generator, folder = bundle.codec.eval(), bundle.generator.eval(), args.output / "tokens"
    with progress_bar() as say:
        count = tokenize_sounds(sounds, codec, generator, folder, seed=args.seed, progress=partial(say, "tokens"))
    print(f"{count} token files in {folder}")
