"""Several files: copies, names given twice, and files that are left open."""

import gc
import warnings

import pytest

from workgauge.site.landxml import blocks
from workgauge.site.read import read_site
from workgauge.site.transitions import Law
from workgauge.values.errors import SiteError


@pytest.fixture
def text(tools):
    w = tools.Writer()
    line = w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0])
    return w.document(w.alignment(line), "<CgPoints><CgPoint name='p'>6783000 21530000 1</CgPoint></CgPoints>")


def test_a_file_given_twice_is_read_once(tmp_path, text):
    path = tmp_path / "a.xml"
    path.write_text(text)
    (tmp_path / "sub").mkdir()
    (tmp_path / "link.xml").symlink_to(path)
    for again in (path, tmp_path / "sub" / ".." / "a.xml", tmp_path / "link.xml"):
        site = read_site([path, again, again])
        assert (len(site.alignments), len(site.points), len(site.files)) == (1, 1, 1)
        assert site.warnings == (f"{again.name}: given twice, read once",)


def test_a_copy_of_a_file_is_read_once(tmp_path, text):
    path, copy, other = (tmp_path / name for name in ("a.xml", "copy.xml", "other.xml"))
    path.write_text(text)
    copy.write_text(text)
    other.write_text(text.replace("Track 1", "Track 2"))
    site = read_site([path, copy, other, copy])
    assert [a.name for a in site.alignments] == ["Track 1", "Track 2"]
    assert site.files == (str(path), str(other))
    assert f"copy.xml: given twice, read once; its content is that of {path}" in site.warnings


def test_alignments_without_a_name_are_numbered_and_doubles_told_apart(tools, read):
    w = tools.Writer()
    line = w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0])
    other = w.element(tools.chain(("line", Law.CONSTANT, 70.0, 0, 0))[0])
    parts = [w.alignment(line, name=n) for n in ("", "A", "A (2)", "", " ")]
    site = read(w.document(*parts, w.alignment(other, name="A")), w.document(w.alignment(other, name="")))
    names = ["alignment 1", "A", "A (2)", "alignment 4", "alignment 5", "A (3)", "alignment 1 (2)"]
    assert [a.name for a in site.alignments] == names
    assert site.alignment("A (3)").length == pytest.approx(70.0)
    told = [t for t in site.warnings if "several alignments are called" in t]
    assert len(told) == 2 and "site0.xml:" in told[0] and "'A'; this one becomes 'A (3)'" in told[0]
    assert sum("has no name; called 'alignment" in t for t in site.warnings) == 4


def test_refused_files_are_closed(tmp_path, text, monkeypatch):
    monkeypatch.setattr(blocks, "_CHUNK", 1)  # so that faults are found while most of the file is still unread
    surface = (
        "<Surfaces><Surface><Definition><Pnts><P id='1'>x</P>"
        + 9000 * "<P id='2'>1 2 3</P>"
        + "</Pnts></Definition></Surface></Surfaces></LandXML>"
    )
    bad = {
        "doctype": text.replace("<LandXML", "<!DOCTYPE x><LandXML", 1),
        "root": "<kml/>",
        "broken": text[:-20],
        "numbers": text.replace("</LandXML>", surface),
        "surface": text.replace("</LandXML>", surface + "<"),
        "empty": "<LandXML/>",
        "encoding": "<?xml version='1.0' encoding='klingon'?><LandXML/>",
    }
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for name, content in bad.items():
            path = tmp_path / f"{name}.xml"
            path.write_text(content)
            with pytest.raises(SiteError):
                read_site([path])
            gc.collect()
    assert [str(w.message) for w in caught if w.category is ResourceWarning] == []


def test_lengths_are_not_rounded(tools, read):
    w = tools.Writer(crs="", origin=(0.0, 0.0))
    line = "<Line><Start>0 0</Start><End>0.1234567890123 100.9876543210987</End></Line>"
    track = read(w.document(w.alignment(line, attributes=' length="100.98772978412345"'))).alignments[0]
    assert track.length == pytest.approx((0.1234567890123**2 + 100.9876543210987**2) ** 0.5, abs=1e-13)
    assert track.declared_length == 100.98772978412345
