"""`echoavatar bench train`: how near a training step comes to the machine's matrix rate."""

import argparse
import json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.description = (
        "Time training steps on random data, and large matrix products in the same number format in the same run. "
        "Report the share of that rate which a generator step reaches, and the share of the time that drawing "
        "batches takes."
    )
    parser.epilog = "example: echoavatar bench train --scale paper --device cuda   (the 0.5B generator, stage 2)"
    parser.add_argument("--stage", choices=("generator", "tokenizer"), default="generator", help="default: %(default)s")
    parser.add_argument(
        "--scale",
        choices=("tiny", "rehearsal", "paper"),
        default="tiny",
        help="sizes and batch, as of `reproduce` (default: %(default)s)",
    )
    parser.add_argument("--device", default="cpu", help="cpu or cuda (default: %(default)s)")
    parser.add_argument("--steps", type=int, default=5, help="steps to time (default: %(default)s)")
    parser.add_argument("--batch", type=int, help="windows per step (default: the scale's)")
    parser.add_argument("--accumulation", type=int, help="pieces of a batch (default: the scale's)")


def run(args: argparse.Namespace) -> int:
    """Time, and print."""
    from echoavatar.motion.kinematics import HUMANOID
    from echoavatar_lab.bench.train import bench_generator, bench_tokenizer
    from echoavatar_lab.models.generator.sequences import compact_layout
    from echoavatar_lab.models.tokenizer.train import body_config
    from echoavatar_lab.tables.scale import SCALES

    scale = SCALES[args.scale]
    pieces = {"batch": args.batch, "accumulation": args.accumulation}
    chosen = {key: value for key, value in pieces.items() if value is not None}
    how = {"device": args.device, "steps": args.steps}
    if args.stage == "tokenizer":
        schedule = scale.tokenizer_training.model_copy(update=chosen)
        report = bench_tokenizer(body_config(HUMANOID, scale.tokenizer), schedule, **how)
    else:
        layers, codes = scale.tokenizer.layers, scale.tokenizer.codes
        layout = compact_layout(audio_codes=1024, motion_layers=layers, motion_codes=codes)
        config = scale.generator.model_copy(update={"layout": layout})
        filled = {"chunks": config.window_chunks + 6, "depth_weights": (1.0,) * layers}
        report = bench_generator(config, scale.generator_training.model_copy(update=filled | chosen), **how)
    print(f"{report.device}: {report.matrix_rate:.3g} Tflop/s in products of {report.number_format}")
    print(
        f"{report.stage}, scale {args.scale}: {report.step_seconds:.3g} s a step, {report.draw_share:.1%} of it drawing"
    )
    if report.share is not None:
        print(f"{report.step_tflop:.3g} Tflop a step: {report.share:.1%} of the matrix rate")
    print(json.dumps(report._asdict()))
    return 0
