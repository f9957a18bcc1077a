"""The routes of owners' pages: sign in, studies, invitations, raters, results, export, audit."""

from pathlib import Path

import msgspec
from starlette.responses import Response
from starlette.routing import BaseRoute

from echoavatar.engine.pipeline import shipped
from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio.files import SOUND_SUFFIXES

from .accounts import log_in, owner_of
from .audit import note, read_audit
from .errors import StudioError, not_found
from .export import EXPORTS, export
from .http import COOKIES, HEADERS, Call, Gate, Work, decoded, reply
from .making import Maker
from .owner_actions import OwnerActions
from .quality import rater_rows
from .rater_routes import set_cookie
from .results import results
from .secrecy import is_name
from .sessions import OWNER_SECONDS, sign_out
from .settings import PAIRWISE_TEMPLATE, PREFERENCE_TEMPLATE, PairwiseStudy, PreferenceStudy, parse_study
from .sources import inside
from .wire_owner import ChangeState, Exclude, Invite, Login, NewStudy, OwnerSession, SetUp, Template
from .wire_rater import Done

PATH = "/api/owner"


def owner_routes(gate: Gate, maker: Maker, library: Path) -> list[BaseRoute]:
    """All routes of owners. Studies that are set up in the page may read only from `library`."""
    own, study = _Owner(gate, maker, library), PATH + "/studies/{study}"
    table: list[tuple[str, str, Work]] = [
        ("POST", f"{PATH}/logout", own.log_out),
        ("GET", f"{PATH}/me", own.me),
        ("GET", f"{PATH}/setup", own.set_up),
        ("GET", f"{PATH}/audit", own.audit),
        ("GET", f"{PATH}/studies", own.studies),
        ("POST", f"{PATH}/studies", own.begin),
        ("GET", study, own.study),
        ("DELETE", study, own.delete),
        ("POST", f"{study}/state", own.change_state),
        ("GET", f"{study}/invitations", own.invitations),
        ("POST", f"{study}/invitations", own.invite),
        ("DELETE", study + "/invitations/{number}", own.revoke),
        ("GET", f"{study}/raters", own.raters),
        ("POST", study + "/raters/{number}/exclude", own.exclude),
        ("DELETE", study + "/raters/{number}", own.delete_rater),
        ("GET", f"{study}/results", own.results),
        ("GET", study + "/export/{name}", own.export),
    ]
    log_in_route = gate.route("POST", f"{PATH}/login", own.log_in, who="owner", signed=False)
    return [log_in_route, *(gate.route(method, path, work, who="owner") for method, path, work in table)]


class _Owner:
    def __init__(self, gate: Gate, maker: Maker, library: Path) -> None:
        self._gate, self._maker, self._library, self._store = gate, maker, library, gate.store
        self._known: set[tuple[str, str]] = set()  # names and addresses that have signed in

    def log_in(self, call: Call) -> Response:
        asked = decoded(call, Login)
        # Only guesses that pass the first limit count towards the account's, and the owner's own address is exempt from
        # that: a stranger who guesses locks out the address it guesses from.
        self._gate.check_rate(f"login {call.address}", self._gate.rates.login)
        if (asked.name, call.address) not in self._known:
            self._gate.check_rate(f"account {asked.name}", self._gate.rates.account)
        token, session = log_in(self._store, asked.name, asked.password)
        self._known.add((asked.name, call.address))
        answer = reply(session)
        set_cookie(answer, call, COOKIES["owner"], token, PATH, OWNER_SECONDS)
        return answer

    def log_out(self, call: Call) -> Done:
        sign_out(self._store, call.signed)
        return Done()

    def me(self, call: Call) -> OwnerSession:
        return OwnerSession(name=owner_of(self._store, call.signed).name, csrf=call.signed.csrf)

    def set_up(self, _: Call) -> SetUp:
        folders = sorted(path for path in self._library.glob("*") if path.is_dir())
        sounds = [path for path in self._library.glob("*") if path.suffix.lower() in SOUND_SUFFIXES]
        sounds += [path for path in folders if any(e.suffix.lower() in SOUND_SUFFIXES for e in path.iterdir())]
        models = [path.name for path in folders if (path / "generator").is_dir()]
        moving = [path.name for path in folders if any(e.suffix in (".npz", ".bvh") for e in path.iterdir())]
        templates = (
            Template(kind="pairwise", settings=PAIRWISE_TEMPLATE),
            Template(kind="preference", settings=PREFERENCE_TEMPLATE),
        )
        return SetUp(
            templates=templates,
            models=("default", *(name for name in (*shipped(), *models) if name != "default")),
            folders=tuple(moving),
            sounds=tuple(sorted(path.name for path in sounds)),
        )

    def audit(self, call: Call) -> msgspec.Struct:
        query = call.request.query_params
        study, before = query.get("study", ""), query.get("before", "")
        if study and not is_name(study):
            raise StudioError("bad_request", "study is the id of a study")
        if before and not (before.isdigit() and len(before) < 16):
            raise StudioError("bad_request", "before is the id of an event")
        return read_audit(self._store, study=study, before=int(before) if before else None)

    def studies(self, call: Call) -> msgspec.Struct:
        return self._actions(call).studies()

    def begin(self, call: Call) -> msgspec.Struct:
        actions = self._actions(call)
        try:
            settings = parse_study(decoded(call, NewStudy).settings, name="settings")
            inside(self._library, _paths(settings))
        except EchoAvatarError as error:
            if isinstance(error, StudioError):
                raise
            raise StudioError("bad_request", str(error)) from error
        public = self._maker.begin(settings, by=actions.actor)
        self._maker.make_later(public, settings, self._library)
        return actions.row(public)

    def study(self, call: Call) -> msgspec.Struct:
        return self._actions(call).study(call.public("study"))

    def delete(self, call: Call) -> Done:
        self._actions(call).delete(call.public("study"))
        return Done()

    def change_state(self, call: Call) -> msgspec.Struct:
        return self._actions(call).change_state(call.public("study"), decoded(call, ChangeState).state)

    def invitations(self, call: Call) -> msgspec.Struct:
        return self._actions(call).invitations(call.public("study"))

    def invite(self, call: Call) -> msgspec.Struct:
        return self._actions(call).invite(call.public("study"), decoded(call, Invite), page=call.page("rate"))

    def revoke(self, call: Call) -> Done:
        self._actions(call).revoke(call.public("study"), call.number("number"))
        return Done()

    def raters(self, call: Call) -> msgspec.Struct:
        return rater_rows(self._store, call.public("study"))

    def exclude(self, call: Call) -> Done:
        asked = decoded(call, Exclude)
        self._actions(call).exclude(
            call.public("study"), call.number("number"), is_excluded=asked.is_excluded, reason=asked.reason
        )
        return Done()

    def delete_rater(self, call: Call) -> Done:
        self._actions(call).delete_rater(call.public("study"), call.number("number"))
        return Done()

    def results(self, call: Call) -> msgspec.Struct:
        return results(self._store, call.public("study"))

    def export(self, call: Call) -> Response:
        public, name = call.public("study"), call.word("name")
        if name not in EXPORTS:
            raise not_found()
        data = export(self._store, self._maker.media, public, name)
        actor = self._actions(call).actor
        with self._store.write() as session:
            note(session, actor, "exported", study=public, detail=name)
        headers = HEADERS | {"content-disposition": f'attachment; filename="{name}"'}
        return Response(data, media_type=EXPORTS[name], headers=headers)

    def _actions(self, call: Call) -> OwnerActions:
        return OwnerActions(self._maker, f"owner {owner_of(self._store, call.signed).name}")


def _paths(settings: PairwiseStudy | PreferenceStudy) -> list[str]:
    paths = [sound.path for sound in settings.sounds]
    models = [settings.model] if settings.kind == "preference" else [system.model for system in settings.systems]
    paths += [model for model in models if model is not None and model not in shipped()]
    if settings.kind == "pairwise":
        paths += [system.clips for system in settings.systems if system.clips is not None]
    return paths
