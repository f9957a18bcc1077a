"""`echoavatar serve --sink unity://...`: serves the authors' Unity projects."""

import argparse
import asyncio
import contextlib
import os
import sys

from echoavatar.errors import EchoAvatarError


def run(args: argparse.Namespace) -> int:
    """Serve one session whose motion goes to a Unity project in its own format."""
    from echoavatar.engine import Engine
    from echoavatar.engine.pipeline import Pipeline, load_bundle
    from echoavatar.server.sinks import parse_address
    from echoavatar_lab.unity import UnitySettings, serve_unity

    address = parse_address(args.sink[0])
    if args.threads:
        os.environ["OMP_NUM_THREADS"] = str(args.threads)
    settings = UnitySettings(
        host=args.host,
        audio_port=args.audio_port,
        action_port=args.action_port,
        unity_host=address.host,
        unity_port=address.port,
    )
    bundle = load_bundle(args.model).running(args.runtime).without(args.without)
    if bundle.runtime.rig is None:
        raise EchoAvatarError(
            f"{args.model} is not made for that Unity project's rig; see `echoavatar import reference`"
        )
    pipeline = Pipeline(bundle, stages=(), output="native", device=args.device)
    pipeline.warm_up()

    def ready(audio: int, action: int) -> None:
        print(f"audio on {args.host}:{audio}, actions on {args.host}:{action}, motion to {address}", flush=True)

    served = serve_unity(Engine(pipeline, rewind=0), bundle.runtime.rig, settings, on_ready=ready)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(served)
    print("echoavatar: stopped", file=sys.stderr)
    return 0
