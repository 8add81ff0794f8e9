"""Opening files: what is accepted as LandXML, and everything that is refused with one clear line."""

import re

import pytest

from workgauge.site.read import read_site
from workgauge.site.transitions import Law
from workgauge.values.errors import SiteError


@pytest.fixture
def good(tools):
    w = tools.Writer()
    return w.document(w.alignment(w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0])))


@pytest.mark.parametrize(
    "namespace",
    [
        "",
        ' xmlns="http://www.landxml.org/schema/LandXML-1.0"',
        ' xmlns="http://www.landxml.org/schema/LandXML-1.1"',
        ' xmlns="http://www.landxml.org/schema/LandXML-2.0"',
        ' xmlns="http://www.inframodel.fi/inframodel"',
        ' xmlns="urn:LandXML-99" xmlns:im="http://im.inframodel.fi"',
    ],
)
def test_namespaces(tools, read, namespace):
    w = tools.Writer(namespace=namespace)
    surface = w.surface(
        [(1, "6783000 21530000 1"), (2, "6783009 21530000 1"), (3, "6783000 21530009 1")], ["<F>1 2 3</F>"]
    )
    line = w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0])
    site = read(w.document(w.alignment(line), surface))
    assert len(site.alignments) == len(site.surfaces) == 1
    prefixed = re.sub(r"<(/?)([A-Z])", r"<\1lx:\2", w.document(w.alignment(line), surface)).replace(
        "xmlns=", "xmlns:lx="
    )
    if namespace:
        assert len(read(prefixed).surfaces[0].faces) == 1


def test_byte_order_marks_and_encodings(read, good):
    text = good.replace("Track 1", "Rata äö")
    for data in (
        b"\xef\xbb\xbf" + text.encode(),
        text.replace("UTF-8", "ISO-8859-1").encode("latin-1"),
        text.replace("UTF-8", "UTF-16").encode("utf-16"),
        text.partition("\n")[2].encode(),
    ):
        assert read(data).alignments[0].name == "Rata äö"


def test_comments_and_processing_instructions_do_not_matter(read, good):
    text = good.replace("<Start>", "<!-- here --><?do this?><Start><!-- N E -->")
    assert read(text).alignments[0].length == pytest.approx(100.0)


BOMB = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>\n'
EXTERNAL = '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>\n'
DTD = '<!DOCTYPE LandXML SYSTEM "http://example.invalid/landxml.dtd">\n'


@pytest.mark.parametrize("doctype", [BOMB, EXTERNAL, DTD])
def test_document_types_and_entities_are_refused(read, good, doctype):
    text = good.replace("<LandXML", doctype + "<LandXML", 1).replace("Track 1", "&a;")
    with pytest.raises(SiteError, match=r"site0\.xml:2: document type declarations and entities are refused"):
        read(text)
    with pytest.raises(SiteError, match="document type"):
        read(text.replace("UTF-8", "UTF-16").encode("utf-16"))


def test_an_entity_that_nobody_declared_is_refused(read, good):
    with pytest.raises(SiteError, match=r"site0\.xml:6: broken or truncated XML.*Entity 'a' not defined"):
        read(good.replace("<Start>", "<Start>&a;"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"site0\.xml:1: the file is empty"),
        ("   \n", r"site0\.xml:2: not XML"),
        ("This is a letter.\n", r"site0\.xml:1: not XML"),
        (b"\x00\x01\x02\xff\xfe", r"site0\.xml:1: not XML"),
        (b"PK\x03\x04 a zip", r"site0\.xml: is compressed \(zip\); unpack it first"),
        (b"\x1f\x8b\x08 LandXML", r"site0\.xml: is compressed \(gzip\); unpack it first"),
        ("ISO-10303-21;\nHEADER;", r"site0\.xml: is an IFC or other STEP file, which is not read"),
        (
            "<kml xmlns='http://www.opengis.net/kml/2.2'/>",
            r"site0\.xml:1: wrong root element \(found kml; allowed: LandXML",
        ),
        ("\n\n<FeatureDictionary/>", r"site0\.xml:3: wrong root element \(found FeatureDictionary"),
        ("<LandXML xmlns='http://example.com/other'/>", r"wrong namespace \(found http://example.com/other"),
        ("<LandXML version='1.2'/>", "holds no alignments, surfaces, points or lines"),
        ("<LandXML><Rikki/></LandXML>", "holds no alignments, surfaces, points or lines"),
        ("<?xml version='1.0' encoding='klingon'?><LandXML/>", "encoding"),
    ],
)
def test_what_is_no_landxml_is_refused(read, text, message):
    with pytest.raises(SiteError, match=message) as caught:
        read(text)
    assert "\n" not in str(caught.value)


def test_truncated_files_are_refused_wherever_they_end(read, good):
    for length in range(60, len(good.rstrip()) - 1, 37):
        with pytest.raises(SiteError, match=r"site0\.xml:\d+: "):
            read(good[:length])


def test_missing_files_and_unknown_kinds(tmp_path, good):
    with pytest.raises(SiteError, match=r"nowhere\.xml: no such file"):
        read_site([tmp_path / "nowhere.xml"])
    with pytest.raises(SiteError, match="cannot be read"):
        read_site([tmp_path])
    with pytest.raises(SiteError, match="no site file given"):
        read_site([])
    path = tmp_path / "notes.txt"
    path.write_text("Dear all")
    with pytest.raises(SiteError, match=r"unknown kind of site file.*LandXML/Inframodel"):
        read_site([path])
    path.write_text(good)
    assert len(read_site([path]).alignments) == 1  # by its content


def test_units_are_needed_where_they_cannot_be_guessed(tools, read, good):
    metric = '<Metric linearUnit="meter" directionUnit="radians"/>'
    assert "states no units" in read(good.replace(f"<Units>{metric}</Units>", "")).warnings[0]
    assert "states no linear unit" in read(good.replace('linearUnit="meter"', "")).warnings[0]
    for change, message in (
        ("<Imperial/>", "states no linearUnit"),
        ('<Metric linearUnit="cubit"/>', "unknown linearUnit.*cubit.*USSurveyFoot"),
    ):
        with pytest.raises(SiteError, match=message):
            read(good.replace(metric, change))
    odd = read(good.replace(metric, '<Metric linearUnit="meter" elevationUnit="millimeter" angularUnit="furlongs"/>'))
    assert any("heights are read in millimeter" in t for t in odd.warnings)
    assert any("unknown angularUnit" in t for t in odd.warnings)
