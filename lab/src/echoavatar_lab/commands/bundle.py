"""`echoavatar bundle`: assemble a trained codec, tokenizer and generator into a bundle, or show a bundle."""

import argparse
import json
import shutil
from pathlib import Path

from echoavatar.errors import EchoAvatarError
from echoavatar.whole_file import make_output_folder, whole_file, write_whole

FILES = ("config.json", "model.safetensors", "card.json")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = (
        "examples:\n  echoavatar bundle runs -o my-bundle     from runs/codec, runs/tokenizer and runs/generator\n"
        "  echoavatar bundle default               show the shipped bundle's card"
    )
    parser.add_argument("source", help="folder with codec/, tokenizer/, generator/ and optionally face/; or a bundle")
    parser.add_argument("-o", "--output", type=Path, help="folder of the new bundle; without it the card is shown")
    parser.add_argument(
        "--int8",
        action="store_true",
        help="store the generator in int8, in which a CPU runs it anyway: half the size (a GPU would run bfloat16)",
    )
    parser.add_argument(
        "--no-graphs",
        action="store_true",
        help="do not export the steps as graphs, which takes a minute: the bundle then runs slower on a CPU",
    )


def run(args: argparse.Namespace) -> int:
    """Assemble a bundle, or show one."""
    from echoavatar.engine.pipeline import load_bundle

    if args.output is None:
        bundle = load_bundle(args.source)
        print(f"{bundle.name}: {bundle.parameters / 1e6:.1f} M parameters, {bundle.skeleton.joints} joints")
        print(json.dumps(bundle.card, indent=2))
        return 0
    assemble(Path(args.source), args.output, is_int8=args.int8, has_graphs=not args.no_graphs)
    bundle = load_bundle(args.output)
    print(f"{args.output}: {bundle.parameters / 1e6:.1f} M parameters; try `echoavatar evaluate {args.output}`")
    return 0


def assemble(source: Path, output: Path, *, is_int8: bool = False, has_graphs: bool = True) -> None:
    """Copy the checkpoints without their training state, with weights in half precision, or the generator's in int8.

    With `has_graphs` the steps of codec, tokenizer and face are exported.

    A face model (`face/`) is copied where it exists. Without an `actions.json`, our own actions are made. Raises
    EchoAvatarError if a part is missing or damaged.
    """
    from echoavatar.stored import read_card
    from echoavatar_lab.models.audio.codec import AudioCodec
    from echoavatar_lab.models.face.model import FaceModel
    from echoavatar_lab.models.generator.model import Generator
    from echoavatar_lab.models.tokenizer.model import BodyTokenizer

    for part in ("codec", "tokenizer", "generator"):
        missing = [name for name in FILES if not (source / part / name).exists()]
        if missing:
            raise EchoAvatarError(f"{source / part} lacks {', '.join(missing)}; train it first (`echoavatar train`)")
    make_output_folder(output)
    BodyTokenizer.load(source / "tokenizer").save(output / "tokenizer", read_card(source / "tokenizer"))
    import torch

    generator_card = {"data": "codes", "licence": "Apache-2.0", "command": "echoavatar train generator"}
    Generator.load(source / "generator").save(
        output / "generator",
        generator_card | read_card(source / "generator"),
        dtype=torch.int8 if is_int8 else torch.float16,
    )
    AudioCodec.load(source / "codec")
    make_output_folder(output / "codec")
    for name in FILES:
        with whole_file(output / "codec" / name) as partial:
            shutil.copyfile(source / "codec" / name, partial)
    if not (output / "actions.json").exists():
        from echoavatar_lab.corpora.rehearsal.own_actions import own_actions

        own_actions(BodyTokenizer.load(output / "tokenizer").eval()).save(output)
    if (source / "face").is_dir():
        FaceModel.load(source / "face").save(output / "face", read_card(source / "face"), dtype=torch.float16)
    if has_graphs:
        from echoavatar_lab.models.export import export_bundle

        export_bundle(output)
    if not (output / "card.json").exists():
        parts = {part.name: read_card(part) for part in sorted(output.iterdir()) if part.is_dir()}
        write_whole(output / "card.json", json.dumps({"licence": "Apache-2.0", "parts": parts}, indent=2) + "\n")
