"""Exported files: what is in them, and what a spreadsheet must not run."""

import csv
import io
import json
import re
import zipfile

import pytest
from studio.tests import canned
from studio.tests.people import RaterPerson, app_of, tokens

from echoavatar_studio.export import EXPORTS, export, pairs
from echoavatar_studio.making import Maker
from echoavatar_studio.results import FILES, PLOTS
from echoavatar_studio.wire_owner import Invite


def test_every_file_has_a_type():
    assert {name for files in FILES.values() for name in files} | set(PLOTS) == set(EXPORTS)


def test_names_that_spreadsheets_would_run_are_quoted(maker: Maker, library):
    systems = [{"name": "=1+1", "clips": "Alpha"}, {"name": "Beta", "clips": "Beta"}]
    study = canned.make_pairwise(maker, library, systems=systems, training=0, checks={"identical": 0, "corrupted": 0})
    rater = RaterPerson(app_of(maker)).begin(tokens(maker, study, 1)[0])
    rater.answer(rater.task())
    data = export(maker.store, maker.media, study, "judgements.csv").decode()
    (row,) = csv.DictReader(io.StringIO(data))
    assert {row["first_system"], row["second_system"]} == {"'=1+1", "Beta"}
    assert row["seconds"] == "3.00"
    told = json.loads(export(maker.store, maker.media, study, "results.json"))
    assert told["judgements"] == 1
    assert export(maker.store, maker.media, study, "raters.csv").decode().startswith("id,label,joined")


@pytest.mark.parametrize(
    "label", ["=HYPERLINK(1)", "+1", "-1", "@a", "\t=1", "\r=1", "\n=1", " =1", '"=1', "a;=1", "a\n@b", "\uff1d1"]
)
def test_no_label_is_a_formula_whatever_ends_a_cell(maker: Maker, library, label: str):
    """Spreadsheets end a cell at a comma, a semicolon or a tab, as their country does."""
    study = canned.make_pairwise(maker, library)
    links = canned.OwnerActions(maker, "test").invite(study, Invite(label=label), page="").links
    RaterPerson(app_of(maker)).begin(links[0].url[1:])
    (row,) = csv.DictReader(io.StringIO(export(maker.store, maker.media, study, "raters.csv").decode(), newline=""))
    assert row["label"].replace("'", "") == label.replace("\r", "\n")
    for cell in re.split(r"[;\t\r\n]", row["label"]):
        assert not re.match(r"""["\s]*[=+\-@\uff1d]""", cell)


def test_excluded_raters_are_not_in_the_pairs(maker: Maker):
    study = canned.make_preference(maker, keep={"votes": 1})
    rater = RaterPerson(app_of(maker)).begin(tokens(maker, study, 1)[0])
    while (task := rater.task()) is not None:
        rater.answer(task)
    assert len(pairs(maker.store, study)) == 3
    canned.OwnerActions(maker, "test").exclude(study, 1, is_excluded=True, reason="")
    assert pairs(maker.store, study) == []
    assert export(maker.store, maker.media, study, "pairs.jsonl") == b""


def test_token_files_come_with_the_pairs(maker: Maker):
    study = canned.make_preference(maker)
    folder = maker.media / study / "tokens"
    folder.mkdir()
    (folder / "clip0.npz").write_bytes(b"tokens")
    with zipfile.ZipFile(io.BytesIO(export(maker.store, maker.media, study, "tokens.zip"))) as whole:
        assert whole.read("tokens/clip0.npz") == b"tokens"
