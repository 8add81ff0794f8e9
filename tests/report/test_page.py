"""The page: self-contained, complete, honest about bad runs, and never half-written."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from workgauge.rehearse.result import Entry, RunResult
from workgauge.report.page import render, write_report
from workgauge.report.verdict import details, headline
from workgauge.values.errors import InputError


class _References(HTMLParser):
    """Collects everything a browser would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in {"src", "href", "xlink:href", "action", "data", "poster", "srcset"}:
                self.found.append((tag, value or ""))

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def test_nothing_outside_is_referred_to(run: RunResult) -> None:
    page = render(run)
    parser = _References()
    parser.feed(page)
    assert parser.found == []
    assert not re.search(r"https?:|//[a-z]|url\(|@import|<script|<iframe|<link", page)


def test_every_picture_is_well_formed_and_finite(run: RunResult) -> None:
    pictures = re.findall(r"<svg.*?</svg>", render(run), flags=re.DOTALL)
    assert len(pictures) == 7
    for picture in pictures:
        ElementTree.fromstring(picture)
        assert "nan" not in picture and "inf" not in picture.replace("inf.", "")


def test_it_says_what_an_engineer_asks(run: RunResult) -> None:
    parser = _References()
    parser.feed(render(run))
    text = " ".join(parser.text)
    assert "Stopped by Pole 12" in text
    assert "0.202 m" in text
    assert "not a certified safety function" in text
    assert "p_u 0.80 m" in text and "p_l 0.20 m" in text
    for name in run.joint_names:
        assert name in text
    for sentence in (*run.assumptions, *run.warnings):
        assert sentence in text
    assert json.loads(text[text.index('{\n  "ticks"') : text.rindex("}") + 1]) == run.as_json()


def test_names_from_files_cannot_break_the_page(run: RunResult) -> None:
    evil = "<script>alert(1)</script>&\"'"
    renamed = replace(run, title=evil, limit_names={"point:Pole 12": evil}, joint_names=(evil, *run.joint_names[1:]))
    page = render(renamed)
    assert "<script" not in page
    for picture in re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL):
        ElementTree.fromstring(picture)


def test_an_entry_is_the_headline(run: RunResult, entry: Entry) -> None:
    bad = replace(run, entries=(entry,), min_clearance_m=-0.031)
    words, good = headline(bad)
    assert not good
    assert "arm entered Pole 12 at 4.00 s, 31 mm deep" in words
    assert "inside a limit 1×" in details(bad)
    assert 'class="verdict bad"' in render(bad)


def test_slowed_is_not_called_stopped(run: RunResult) -> None:
    slowed = replace(run, interventions=(replace(run.interventions[0], scale=0.4),))
    assert headline(slowed)[0].startswith("Slowed by Pole 12")
    assert headline(replace(run, interventions=()))[0].startswith("Nothing held")


def test_what_is_said_of_the_approach_is_the_guards_own_rule(run: RunResult) -> None:
    assert "slowed in proportion" in render(run)
    assert "as late as still stops" in render(replace(run, slow_distance_m=None))
    free = render(replace(run, slow_distance_m=None, stop_distance_m=None))
    assert "knows no limits" in free and "never slowed" not in free


def test_a_run_with_nothing_in_sight_still_makes_a_page(run: RunResult) -> None:
    nothing = np.full(len(run.series), np.nan)
    far = replace(
        run,
        series=replace(run.series, true_m=nothing, believed_m=nothing, by_limit={}),
        min_clearance_m=None,
        min_limit=None,
        min_link=None,
        interventions=(),
        limits=(),
        nearest=replace(run.nearest, point_limit=None, point_machine=None, clearance_m=None, limit=None),
    )
    assert "No limit was in sight" in render(far)
    assert far.as_json()["min_clearance_m"] is None


def test_json_has_exactly_the_documented_keys(run: RunResult) -> None:
    data = run.as_json()
    assert list(data) == [
        "ticks",
        "simulated_s",
        "min_clearance_m",
        "entries",
        "interventions",
        "tick_ms",
        "min_self_clearance_m",
        "self_entries",
        "chatter",
        "positioning",
        "travel",
        "automatic",
        "dug",
        "warnings",
    ]
    first = data["interventions"][0]
    assert list(first)[:6] == ["t_s", "until_s", "reason", "link", "limit", "joint"]
    assert list(first)[6:] == ["clearance_m", "protection_m", "stop_distance_m", "scale", "text"]
    assert list(data["tick_ms"]) == ["p50", "p99", "max"]


def test_the_folder_is_made_and_holds_two_files(run: RunResult, folder: Path) -> None:
    page = write_report(run, folder)
    assert page == folder / "report.html"
    assert sorted(path.name for path in folder.iterdir()) == ["report.html", "run.json"]
    assert json.loads((folder / "run.json").read_text()) == run.as_json()


def test_a_folder_that_cannot_be_written_is_one_clear_error(run: RunResult, tmp_path: Path) -> None:
    file = tmp_path / "taken"
    file.write_text("a file, not a folder")
    with pytest.raises(InputError, match="cannot be written"):
        write_report(run, file)
    assert file.read_text() == "a file, not a folder"
