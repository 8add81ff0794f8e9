"""Damaged files: whatever bytes change, the reader gives a site or refuses, and never fails otherwise."""

import random
import re
import tempfile
import warnings
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.errors import InputError


@pytest.fixture(scope="module")
def document(tools) -> bytes:
    w = tools.Writer()
    rest = (
        "<StaEquation staBack='300' staAhead='350'/><Profile><ProfAlign><PVI>0 10</PVI>"
        "<CircCurve radius='5000' length='60'>300 13</CircCurve><ParaCurve length='80'>600 10</ParaCurve>"
        "<UnsymParaCurve lengthIn='40' lengthOut='60'>900 12</UnsymParaCurve><PVI>1180 9</PVI></ProfAlign></Profile>"
        "<Cant gauge='1.435' rotationPoint='insideRail'><CantStation station='0' appliedCant='0' curvature='ccw'/>"
        "<CantStation station='200' appliedCant='60' curvature='ccw' transitionType='bloss'/></Cant>"
    )
    surface = w.surface(
        [(1, "6783000 21530000 1"), (2, "6783009 21530000 2"), (3, "6783000 21530009 3"), (4, "6783009 21530009 2")],
        ["<F>1 2 3</F>", '<F i="1">2 3 4</F>', "<F>2 3 4</F>"],
    )
    others = (
        '<CgPoints name="g"><CgPoint name="p" code="1">6783000 21530000 4</CgPoint></CgPoints>'
        "<PlanFeatures><PlanFeature name='f'><CoordGeom><IrregularLine><PntList2D>6783000 21530000 6783009 21530001"
        "</PntList2D></IrregularLine></CoordGeom></PlanFeature><PlanFeature name='l'><Location>6783000 21530000 4"
        "</Location></PlanFeature></PlanFeatures><PipeNetworks><PipeNetwork><Structs><Struct name='s' elevRim='4'>"
        "<Center pntRef='p'/><CircStruct diameter='0.4'/></Struct></Structs></PipeNetwork></PipeNetworks>"
    )
    elements = [w.element(e) for e in tools.track()]
    return w.document(w.alignment(*elements, attributes=' length="1180"', rest=rest), surface, others).encode()


def outcome(data: bytes) -> SiteModel | InputError:
    result = tried(data)
    lines = [str(result)] if isinstance(result, InputError) else result.warnings
    assert not any("\n" in line for line in lines)
    return result


def tried(data: bytes) -> SiteModel | InputError:
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        path = Path(folder) / "site.xml"
        path.write_bytes(data)
        try:
            site = read_site([path])
        except InputError as error:
            return error
        for alignment in site.alignments:
            state = alignment.at(alignment.breaks)
            assert abs(state.e).max() < 1e9 and abs(state.cant).max() <= 0.35
        return site


def test_the_document_itself_is_read(document):
    site = outcome(document)
    assert isinstance(site, SiteModel)
    assert (len(site.alignments), len(site.surfaces), len(site.points), len(site.lines)) == (1, 1, 3, 1)


NASTY = (
    "",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-1",
    "0",
    "1e-320",
    "1e300",
    "9" * 400,
    "x",
    "\x00",
    "&a;",
    "1_0",
    "٣",
    "1 2",
)


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_numbers_replaced_by_nonsense(document, data):
    text = document.decode()
    numbers = list(re.finditer(r"-?\d+(?:\.\d+)?", text))
    for _ in range(data.draw(st.integers(1, 3))):
        match = data.draw(st.sampled_from(numbers))
        text = text[: match.start()] + data.draw(st.sampled_from(NASTY)) + text[match.end() :]
        numbers = list(re.finditer(r"-?\d+(?:\.\d+)?", text))
    outcome(text.encode())


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_elements_and_attributes_lost_or_doubled(document, data):
    text = document.decode()
    for _ in range(data.draw(st.integers(1, 3))):
        pattern = data.draw(st.sampled_from([r' [a-zA-Z]+="[^"]*"', r"<(\w+)[^<>]*>[^<>]*</\1>", r"<\w+[^<>]*/>"]))
        found = list(re.finditer(pattern, text))
        match = data.draw(st.sampled_from(found))
        replacement = match[0] * data.draw(st.sampled_from([0, 2]))
        text = text[: match.start()] + replacement + text[match.end() :]
    outcome(text.encode())


def damage(document: bytes, seed: int) -> bytes:
    chance = random.Random(seed)
    data = bytearray(document)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(max(1, len(data) - 1))
        kind = chance.randrange(4)
        if kind == 0 and data:
            data[at] = chance.randrange(256)
        elif kind == 1:
            del data[at : at + chance.randint(1, 40)]
        elif kind == 2:
            data[at:at] = data[at : at + chance.randint(1, 80)]
        else:
            data = data[: at + 1]
    return bytes(data)


def test_bytes_damaged_at_random(document):
    refused = sum(isinstance(outcome(damage(document, seed)), InputError) for seed in range(300))
    assert refused > 100


@pytest.mark.prove
def test_very_many_damaged_files(document):
    for seed in range(300, 100_000):
        outcome(damage(document, seed))
