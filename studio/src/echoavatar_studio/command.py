"""`echoavatar studio`: people compare motion in a browser; owners set up, watch and export."""

import argparse
import contextlib
import getpass
import os
import sys
import time
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from echoavatar.errors import EchoAvatarError
from echoavatar.whole_file import make_output_folder, write_whole

if TYPE_CHECKING:
    from .making import Maker
    from .store import Store

PASSWORD = "ECHOAVATAR_STUDIO_PASSWORD"
ACTIONS = ("serve", "demo", "owner", "export", "backup", "restore", "simulate")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = (
        "examples:\n"
        "  echoavatar studio demo                         a filled example study in the browser\n"
        "  echoavatar studio --study study.yaml           make and open a study, then serve\n"
        "  echoavatar studio --store postgresql://me@host/studio --host 0.0.0.0 --certificate c.pem --key k.pem\n"
        "  echoavatar studio owner --name anna            a new owner, or a new password\n"
        "  echoavatar studio export --id STUDY -o results\n"
        "  echoavatar studio simulate --study study.yaml -o results   made-up raters judge it, from clips to tables\n"
        "  echoavatar studio backup -o studio.zip         while it runs; `restore -o studio.zip` into an empty one\n"
        "\nThe form of study.yaml, the pages and the API: docs/studio.md.\n"
    )
    parser.add_argument(
        "action", nargs="?", choices=ACTIONS, default="serve", help="default: serve", metavar="|".join(ACTIONS)
    )
    parser.add_argument("--study", type=Path, action="append", default=[], metavar="YAML", help="make this study first")
    parser.add_argument("--folder", type=Path, help="folder of clips and data (default: studio; demo: studio-demo)")
    parser.add_argument(
        "--store", metavar="URL", help="sqlite:///FILE or postgresql://USER@HOST/NAME (default: a file in the folder)"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8768, help="port; 0: any free one (default: %(default)s)")
    parser.add_argument(
        "--origin", action="append", default=[], metavar="URL", help="address under which a proxy shows the pages"
    )
    parser.add_argument(
        "--proxy",
        action="append",
        default=[],
        metavar="ADDRESS",
        help="address or network of a proxy whose X-Forwarded-For and -Proto are believed (default: none)",
    )
    parser.add_argument("--certificate", "--tls-cert", metavar="PEM", help="TLS certificate, with --key: https")
    parser.add_argument("--key", "--tls-key", metavar="PEM", help="its private key, without a password")
    parser.add_argument("--model", default="default", help="demo: bundle (default: %(default)s)")
    parser.add_argument("--name", default="owner", help="owner: name of the owner (default: %(default)s)")
    parser.add_argument("--id", metavar="STUDY", help="export: the study's id (default: the newest)")
    parser.add_argument("-o", "--output", type=Path, help="export, simulate: folder; backup, restore: ZIP")
    parser.add_argument("--no-browser", action="store_true", help="demo: print the page's address without opening it")


def run(args: argparse.Namespace) -> int:
    """Run the action."""
    from echoavatar.wire.guard import check_certificate

    from .making import Maker
    from .run import open_store

    if bool(args.certificate) != bool(args.key):
        raise EchoAvatarError("--certificate and --key go together; give both or neither")
    if args.certificate:  # before studies are made, which takes long
        check_certificate(args.certificate, args.key)
    folder = args.folder or Path("studio-demo" if args.action == "demo" else "studio")
    store = open_store(folder, args.store)
    try:
        match args.action:
            case "owner":
                return _owner(store, args.name)
            case "export":
                return _export(store, folder / "media", args)
            case "simulate":
                return _simulate(Maker(store, folder / "media"), args)
            case "backup" | "restore":
                return _copy(store, folder / "media", args)
        return _serve(store, Maker(store, folder / "media"), folder, args)
    finally:
        store.close()


def _serve(store: "Store", maker: "Maker", folder: Path, args: argparse.Namespace) -> int:
    from .accounts import first_owner
    from .app import create_app
    from .demo import is_filled, make_demo
    from .owner_actions import OwnerActions
    from .run import mark_broken, serve
    from .settings import read_study
    from .wire_owner import Invite

    mark_broken(store)
    actions = OwnerActions(maker, "studio")
    if args.action == "demo" and not is_filled(store):
        with _Bar() as bar:
            make_demo(maker, folder / "library", model=args.model, progress=bar.show)
    for path in args.study:
        settings = read_study(path)
        public = maker.known(settings)
        if public is None:
            public = maker.begin(settings, by="studio")
            with _Bar() as bar:
                maker.make(public, settings, path.parent, progress=bar.show)
        print(f"{settings.title}: study {public}", flush=True)
    password = first_owner(store)
    origins = tuple(origin.rstrip("/") for origin in args.origin)
    app = create_app(maker, library=folder / "library", origins=origins)

    def ready(address: str) -> None:
        print(f"the studio is at {address}/  (Ctrl-C stops)", flush=True)
        if password:
            print(f"owner: owner   password: {password}   (shown once; change it with `studio owner`)", flush=True)
        if args.action == "demo":
            for study in actions.studies().studies:
                if study.state == "open" and study.raters < study.raters_wanted:
                    link = actions.invite(study.id, Invite(), page=f"{address}/rate").links[0]
                    print(f"judge “{study.title}”: {link.url}", flush=True)
            if not args.no_browser:
                webbrowser.open(f"{address}/")

    with contextlib.suppress(KeyboardInterrupt):  # uvicorn raises it again when all is closed
        serve(
            app,
            host=args.host,
            port=args.port,
            on_ready=ready,
            certificate=args.certificate,
            key=args.key,
            proxies=tuple(args.proxy),
            origins=origins,
        )
    print("echoavatar: stopped", file=sys.stderr)
    return 0


def _owner(store: "Store", name: str) -> int:
    from .accounts import set_owner

    try:
        password = os.environ.get(PASSWORD) or getpass.getpass(f"password of {name}: ")
    except EOFError as error:
        raise EchoAvatarError(f"nobody typed a password; type one, or set {PASSWORD}") from error
    set_owner(store, name, password)
    print(f"{name} may sign in")
    return 0


def _export(store: "Store", media: Path, args: argparse.Namespace) -> int:
    from .audit import note
    from .export import export
    from .making import Maker
    from .owner_actions import OwnerActions
    from .results import results

    studies = OwnerActions(Maker(store, media), "studio").studies().studies
    chosen = [study for study in studies if args.id in (None, study.id)]
    if not chosen:
        raise EchoAvatarError(f"there is no study {args.id or ''}; known: {', '.join(s.id for s in studies) or 'none'}")
    output, public = args.output or Path(f"study-{chosen[0].id}"), chosen[0].id
    make_output_folder(output)
    for name in (*(found := results(store, public)).exports, *found.plots):
        data = export(store, media, public, name)
        write_whole(output / name, data)
        print(f"{output / name}  {len(data)} bytes")
    with store.write() as session:
        note(session, "studio", "exported", study=public, detail=str(output))
    return 0


def _simulate(maker: "Maker", args: argparse.Namespace) -> int:
    from .rehearsal import as_text, rehearse_study
    from .settings import read_study

    if not args.study:
        raise EchoAvatarError("`studio simulate` needs a study; give one or more with --study")
    for path in args.study:
        settings = read_study(path)
        if settings.kind != "pairwise":
            raise EchoAvatarError(f"{path} is a study of candidates; `studio simulate` judges pairwise ones")
        public, found = rehearse_study(maker, settings, path.parent)
        print(f"{settings.title}: study {public}\n{as_text(found)}", flush=True)
        output = (args.output or Path("simulated")) / path.stem
        _export(maker.store, maker.media, argparse.Namespace(id=public, output=output))
    return 0


def _copy(store: "Store", media: Path, args: argparse.Namespace) -> int:
    from .backup import back_up, restore

    path = args.output or Path(time.strftime("studio-%Y%m%d-%H%M%S.zip"))
    counts = (back_up if args.action == "backup" else restore)(store, media, path)
    print(f"{path}: {', '.join(f'{count} {name}' for name, count in counts.items())}")
    return 0


class _Bar:
    """A progress bar, labelled with the clip that is being made."""

    def __enter__(self) -> "_Bar":
        self._bar: tqdm[object] = tqdm(unit="clip", disable=not sys.stderr.isatty())
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def show(self, done: int, of: int, what: str) -> None:
        """Show the progress."""
        self._bar.total, self._bar.n = of, done
        self._bar.set_description(what[:40])
