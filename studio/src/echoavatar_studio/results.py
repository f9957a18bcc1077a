"""The results of a study so far: means with intervals, rankings, agreement of raters, pairs for DPO."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

from sqlalchemy import select
from sqlalchemy.orm import Session

from .agreement import alpha
from .answers import AnswerRecord, answer_records, counted
from .bradley_terry import strengths, wins_of
from .intervals import mean_of
from .owner_actions import find_study
from .settings import PairwiseStudy, PreferenceStudy, kept_study
from .store import Store
from .tables import Sound, Study, Trial
from .voting import Verdict, verdict
from .wire import CATEGORIES, Category, Question
from .wire_owner import Agreement, Mean, PairRow, PreferenceRow, ResultRow, Results, Strength

PLOTS = ("means.svg", "ranking.svg")
FILES: Mapping[str, tuple[str, ...]] = {
    "pairwise": ("judgements.csv", "raters.csv", "results.json", "table.tex"),
    "preference": ("judgements.csv", "raters.csv", "results.json", "pairs.jsonl", "tokens.zip"),
}


def results(store: Store, public: str) -> Results:
    """All results, from the answers of raters who are not excluded."""
    with store.read() as session:
        study = find_study(session, public)
        settings, everything = kept_study(study.settings), answer_records(session, study)
        answers = counted(everything)
        is_pairwise = settings.kind == "pairwise"
        judged = [] if settings.kind == "pairwise" else verdicts(session, study, settings, answers)
    return Results(
        kind=settings.kind,
        judgements=len(answers),
        raters=len({answer.rater for answer in answers}),
        excluded=len({answer.rater for answer in everything if answer.is_excluded}),
        rows=tuple(system_rows(settings, answers)) if settings.kind == "pairwise" else (),
        pairs=tuple(pair_rows(settings, answers)) if settings.kind == "pairwise" else (),
        ranking=tuple(ranking(settings, answers)) if settings.kind == "pairwise" else (),
        agreement=tuple(_pairwise_alpha(settings, answers) if settings.kind == "pairwise" else _best_alpha(answers)),
        preferences=tuple(_preference(row) for row in judged),
        plots=PLOTS if is_pairwise else (),
        exports=FILES[settings.kind],
    )


def system_rows(settings: PairwiseStudy, answers: Sequence[AnswerRecord]) -> list[ResultRow]:
    """Each system's mean rating against the others of its group: the rows of the paper's table."""
    rows = []
    for system in settings.systems:
        for category in _categories(answers):
            own = [answer for answer in answers if answer.category == category and system.name in answer.systems]
            scores = _scores(settings.questions, ((answer, _towards(answer, system.name)) for answer in own))
            if scores:
                rows.append(ResultRow(system=system.name, group=system.group, category=category, scores=scores))
    return rows


def pair_rows(settings: PairwiseStudy, answers: Sequence[AnswerRecord]) -> list[PairRow]:
    """A row for every two systems that were compared."""
    rows = []
    for one, other in combinations(settings.systems, 2):
        for category in _categories(answers):
            own = [a for a in answers if a.category == category and set(a.systems) == {one.name, other.name}]
            scores = _scores(settings.questions, ((answer, _towards(answer, one.name)) for answer in own))
            if scores:
                rows.append(PairRow(first=one.name, second=other.name, category=category, scores=scores))
    return rows


def ranking(settings: PairwiseStudy, answers: Sequence[AnswerRecord]) -> list[Strength]:
    """Bradley-Terry strengths within each group, for every question, over all categories and for each."""
    rows = []
    for group in dict.fromkeys(system.group for system in settings.systems):
        names = [system.name for system in settings.systems if system.group == group]
        for question in settings.questions:
            for category in ("all", *_categories(answers)):
                own = [
                    (names.index(answer.systems[0]), names.index(answer.systems[1]), answer.ratings[question])
                    for answer in answers
                    if question in answer.ratings
                    and answer.systems[0] in names
                    and category in ("all", answer.category)
                ]
                if not own:
                    continue
                fitted = strengths(wins_of(len(names), own))
                order = sorted(range(len(names)), key=lambda at: -fitted.values[at])  # noqa: B023  called at once
                rows += [
                    Strength(
                        system=names[at],
                        group=group,
                        question=question,
                        category=category,  # type: ignore[arg-type]
                        strength=float(fitted.values[at]),
                        low=float(fitted.values[at] - fitted.halves[at]),
                        high=float(fitted.values[at] + fitted.halves[at]),
                        rank=place + 1,
                    )
                    for place, at in enumerate(order)
                ]
    return rows


def verdicts(
    session: Session, study: Study, settings: PreferenceStudy, answers: Sequence[AnswerRecord]
) -> list[tuple[Trial, Sound, Verdict]]:
    """The verdict of the raters on every prompt."""
    votes: dict[int, list[tuple[int, int] | None]] = defaultdict(list)
    for answer in answers:
        if answer.skipped == "no_difference":
            votes[answer.trial].append(None)
        elif answer.best is not None and answer.worst is not None:
            votes[answer.trial].append((answer.best, answer.worst))
    real = session.execute(
        select(Trial, Sound)
        .join(Sound, Trial.sound_id == Sound.id)
        .where(Trial.study_id == study.id, Trial.role == "real")
        .order_by(Trial.id)
    )
    return [(trial, sound, verdict(votes[trial.id], len(trial.clips), settings.keep)) for trial, sound in real]


def _preference(row: tuple[Trial, Sound, Verdict]) -> PreferenceRow:
    _, sound, found = row
    return PreferenceRow(sound=sound.name, category=sound.category, **found._asdict())  # type: ignore[arg-type]


def _towards(answer: AnswerRecord, system: str) -> int:
    """1 if the system is the trial's first clip, -1 if it is the second."""
    return 1 if answer.systems[0] == system else -1


def _scores(questions: Sequence[Question], own: Iterable[tuple[AnswerRecord, int]]) -> dict[Question, Mean]:
    rated = [(answer, sign) for answer, sign in own if answer.ratings]
    return {
        question: mean_of([sign * a.ratings[question] for a, sign in rated], [a.rater for a, _ in rated])
        for question in questions
        if rated
    }


def _categories(answers: Sequence[AnswerRecord]) -> list[Category]:
    there = {answer.category for answer in answers}
    return [category for category in CATEGORIES if category in there]


def _pairwise_alpha(settings: PairwiseStudy, answers: Sequence[AnswerRecord]) -> list[Agreement]:
    """The order of two systems in a trial is arbitrary, so every trial counts twice, with either sign."""
    rows = []
    for question in settings.questions:
        units: dict[int, list[int]] = defaultdict(list)
        for answer in answers:
            if question in answer.ratings:
                units[answer.trial].append(answer.ratings[question])
                units[-answer.trial].append(-answer.ratings[question])
        rows.append(_agreement(question, "ordinal", units, answers))
    return rows


def _best_alpha(answers: Sequence[AnswerRecord]) -> list[Agreement]:
    rows = []
    for which in ("best", "worst"):
        units: dict[int, list[int]] = defaultdict(list)
        for answer in answers:
            if (place := getattr(answer, which)) is not None:
                units[answer.trial].append(place)
        rows.append(_agreement(which, "nominal", units, answers))
    return rows


def _agreement(
    question: str, metric: str, units: Mapping[int, Sequence[int]], answers: Sequence[AnswerRecord]
) -> Agreement:
    values = [list(unit) for unit in units.values()]
    found = alpha(values, metric)  # type: ignore[arg-type]
    paired = sum(len(unit) > 1 for trial, unit in units.items() if trial > 0)
    return Agreement(
        question=question,
        metric=metric,  # type: ignore[arg-type]
        alpha=found,
        units=paired,
        raters=len({answer.rater for answer in answers}),
    )
