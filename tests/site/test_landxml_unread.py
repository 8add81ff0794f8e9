"""What is not read is counted and told, and what cannot be read in part is refused."""

import pytest

from workgauge.site.transitions import Law
from workgauge.values.errors import SiteError


@pytest.fixture
def with_more(tools, read):
    """Return a function that reads a straight track with more elements in the file, or in the alignment."""

    def make(*parts: str, rest: str = "", inside: str = ""):
        w = tools.Writer()
        line = w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0])
        return read(w.document(w.alignment(line, inside, rest=rest), *parts))

    return make


@pytest.mark.parametrize(
    ("part", "told"),
    [
        (
            "<Roadways><Roadway><Roadside><RoadSign/><RoadSign/><RoadSign/></Roadside></Roadway></Roadways>",
            "3 RoadSign",
        ),
        ("<Roadways><Roadway><RoadSigns><RoadSign/><RoadSign/></RoadSigns></Roadway></Roadways>", "2 RoadSign"),
        ("<RoadSign>6783000 21530000 4</RoadSign>", "1 RoadSign"),
        ("<Parcels><Parcel/><Parcel/></Parcels>", "2 Parcel"),
        ("<GradeModel/>", "1 GradeModel"),
        ("<PlanFeatures><PlanFeature><Footprint/></PlanFeature></PlanFeatures>", "1 Footprint"),
        ("<Surfaces><Surface name='s'><Watersheds/></Surface></Surfaces>", "1 Watersheds"),
        ("<PipeNetworks><PipeNetwork><Structs/><Pumps><Pump/></Pumps></PipeNetwork></PipeNetworks>", "1 Pump"),
        ("<Survey><CgPoints/><InstrumentSetup/></Survey>", "1 InstrumentSetup"),
    ],
)
def test_elements_that_are_not_read_are_counted(with_more, part, told):
    text = " ".join(with_more(part).warnings)
    assert f"{told} element{' is' if told.startswith('1 ') else 's are'} not read" in text
    assert "site0.xml:" in text


def test_nothing_is_said_of_what_is_no_part_of_the_site(with_more):
    parts = (
        "<Project/><Application><Author/></Application><FeatureDictionary><DocFileRef/></FeatureDictionary>"
        "<Roadways><Roadway><Classification/><Speeds/></Roadway></Roadways><Survey><CgPoints/></Survey>"
    )
    site = with_more(parts, rest="<AlignPIs><AlignPI/></AlignPIs><Cant><SpeedStation/></Cant><Feature/>")
    assert site.warnings == ()


def test_profiles_of_the_ground_are_counted(with_more):
    ground = "<Profile><ProfSurf name='g'><PntList2D>0 1 9 2</PntList2D></ProfSurf></Profile>"
    site = with_more(rest=ground + "<CrossSects><CrossSect/></CrossSects>")
    assert not site.alignments[0].has_profile
    text = " ".join(site.warnings)
    assert "1 ProfSurf element is not read" in text and "1 CrossSect element is not read" in text


def test_an_alignment_with_an_element_nobody_knows_is_refused(with_more):
    with pytest.raises(
        SiteError, match=r"site0\.xml:\d+: CompoundCurve: Alignment 'Track 1' has an element that is not"
    ):
        with_more(inside="<CompoundCurve/>")


def test_the_first_of_several_geometries_is_used_and_told(with_more):
    rest = "<CoordGeom><Line><Start>6783000 21530000</Start><End>6783500 21530000</End></Line></CoordGeom>"
    site = with_more(rest=rest)
    assert site.alignments[0].length == pytest.approx(100.0)
    assert any("has 2 geometries; the first is used" in t for t in site.warnings)


def test_a_file_of_nothing_that_is_read_says_what_it_holds(tools, read):
    with pytest.raises(
        SiteError, match=r"holds no alignments, surfaces, points or lines \(found 2 Parcel, 1 GradeModel"
    ):
        read(tools.Writer().document("<Parcels><Parcel/><Parcel/></Parcels><GradeModel/>"))
