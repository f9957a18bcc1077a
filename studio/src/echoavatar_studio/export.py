"""Files for owners: tables, the paper's table, pictures, and pairs that `align dpo` reads."""

import csv
import io
import re
import zipfile
from collections.abc import Sequence
from pathlib import Path

import msgspec
from sqlalchemy import select

from echoavatar_lab.align.dpo import PreferencePair

from .answers import answer_records, counted
from .audit import iso
from .errors import not_found
from .latex import latex_table
from .owner_actions import find_study
from .quality import rater_rows
from .results import FILES, PLOTS, results, verdicts
from .settings import kept_study
from .store import Store
from .tables import Clip
from .wire import QUESTIONS

_FORMULA = re.compile(r"""((?:^|[;\t\n])["\s]*)([=+\-@\uff1d\uff0b\uff0d\uff20])""")  # and the wide forms
EXPORTS = {
    "judgements.csv": "text/csv; charset=utf-8",
    "raters.csv": "text/csv; charset=utf-8",
    "results.json": "application/json",
    "table.tex": "application/x-tex",
    "pairs.jsonl": "application/jsonl",
    "tokens.zip": "application/zip",
    "means.svg": "image/svg+xml",
    "ranking.svg": "image/svg+xml",
}


def export(store: Store, media: Path, public: str, name: str) -> bytes:
    """The bytes of one of `EXPORTS`.

    Raises:
        StudioError: no such study, or a file that this kind of study does not have.
    """
    with store.read() as session:
        settings = kept_study(find_study(session, public).settings)
    if name not in (*FILES[settings.kind], *(PLOTS if settings.kind == "pairwise" else ())):
        raise not_found()
    match name:
        case "judgements.csv":
            return _judgements(store, public)
        case "raters.csv":
            rows = [msgspec.structs.asdict(row) for row in rater_rows(store, public).raters]
            return _csv([list(row.values()) for row in rows], list(rows[0]) if rows else [])
        case "results.json":
            return msgspec.json.format(msgspec.json.encode(results(store, public)), indent=1) + b"\n"
        case "pairs.jsonl":
            return "".join(pair.model_dump_json() + "\n" for pair in pairs(store, public)).encode()
        case "tokens.zip":
            return _tokens(media / public / "tokens")
    found = results(store, public)
    assert settings.kind == "pairwise"
    if name == "table.tex":
        caption = f"{settings.title}: mean and 95 % confidence interval of {found.judgements} judgements"
        return latex_table(found.rows, settings.questions, caption=caption).encode()
    from .plots import draw_means, draw_ranking

    return draw_means(found.rows, settings.questions) if name == "means.svg" else draw_ranking(found.ranking)


def pairs(store: Store, public: str) -> list[PreferencePair]:
    """The pairs of a preference study that are distinct enough. `margin` is a share of raters, as `by` says.

    Raises:
        StudioError: no such study, or one of the other kind.
    """
    with store.read() as session:
        study = find_study(session, public)
        settings = kept_study(study.settings)
        if settings.kind != "preference":
            raise not_found()
        found = []
        for trial, sound, told in verdicts(session, study, settings, counted(answer_records(session, study))):
            if not told.is_kept or told.chosen is None or told.rejected is None or sound.prompt is None:
                continue
            clips = {clip.id: clip for clip in session.scalars(select(Clip).where(Clip.sound_id == sound.id))}
            better, worse = (clips[trial.clips[place]] for place in (told.chosen, told.rejected))
            prompt = {name: sound.prompt[name] for name in ("clip", "start", "past")}
            found.append(
                PreferencePair.model_validate(
                    prompt
                    | {
                        "chosen": better.codes,
                        "rejected": worse.codes,
                        "margin": told.margin,
                        "by": f"{told.votes} raters",
                        "audio": sound.name,
                        "model": settings.model,
                        "seeds": (better.seed, worse.seed),
                    }
                )
            )
        return found


def _judgements(store: Store, public: str) -> bytes:
    """One line per answer, with practice and checks; ratings are towards `first_system`."""
    with store.read() as session:
        answers = answer_records(session, find_study(session, public))
    head = ["rater", "is_excluded", "role", "sound", "category", "first_system", "second_system", *QUESTIONS]
    head += ["best", "worst", "skipped", "is_swapped", "played_first", "seconds", "plays", "at"]
    rows = []
    for answer in answers:
        names = [name or "(spoilt)" for name in answer.systems[:2]] if answer.ratings else ["", ""]
        rows.append(
            [
                answer.rater,
                int(answer.is_excluded),
                answer.role,
                answer.sound,
                answer.category,
                *names,
                *(answer.ratings.get(question, "") for question in QUESTIONS),
                "" if answer.best is None else answer.best + 1,
                "" if answer.worst is None else answer.worst + 1,
                answer.skipped or "",
                int(answer.order[0] == 1) if answer.ratings else "",
                answer.order[answer.first] + 1 if answer.ratings else "",
                f"{answer.seconds:.2f}",
                " ".join(str(count) for count in answer.plays),
                iso(answer.at),
            ]
        )
    return _csv(rows, head)


def _csv(rows: Sequence[Sequence[object]], head: Sequence[str]) -> bytes:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([[_plain(cell) for cell in row] for row in rows])
    return out.getvalue().encode()


def _plain(cell: object) -> object:
    """Put a quote before text that a spreadsheet would take for a formula, and write line ends alike.

    Where a country writes decimal commas, spreadsheets begin a new cell at a semicolon, also within quotes.
    """
    if not isinstance(cell, str):
        return cell
    text = cell.replace("\r\n", "\n").replace("\r", "\n")  # the writer puts no quotes around a lone \r
    return _FORMULA.sub(r"\1'\2", text)


def _tokens(folder: Path) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as whole:
        for path in sorted(folder.glob("*.npz")):
            whole.write(path, f"tokens/{path.name}")
    return out.getvalue()
