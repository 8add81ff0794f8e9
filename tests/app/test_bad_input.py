"""Every kind of bad input: exit code 2, one clear line on stderr, nothing on stdout, nothing written."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from workgauge.rehearse.shipped import shipped_path

BOMB = (
    '<?xml version="1.0"?>\n<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(9))
    + "]>\n<LandXML><Project name='&j;'/></LandXML>"
)
EXTERNAL = (
    '<?xml version="1.0"?>\n<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>\n'
    "<LandXML><Project name='p'>&e;</Project></LandXML>"
)


def _bad_sites(cli) -> dict[str, tuple[str | bytes, str]]:
    """Return name -> (file, word that the message must have)."""
    good = cli.document(cli.alignment(cli.STRAIGHT))
    e, n = cli.E0, cli.N0
    points = f'<P id="1">{n} {e} 1</P><P id="2">{n} {e + 9} 1</P><P id="3">{n + 9} {e} 1</P>'
    stations = "".join(f"<CantStation station='{s}' appliedCant='5000' curvature='ccw'/>" for s in (1010, 1100))
    cant = f"<Cant name='c' gauge='1435' rotationPoint='center'>{stations}</Cant>"
    return {
        "not XML": ("machine: none\n", "XML"),
        "binary": (bytes(range(256)), "XML"),
        "truncated": (good[: len(good) // 2], "XML|truncated|end"),
        "empty": ("", "empty|XML"),
        "bomb": (BOMB, "entit"),
        "external entity": (EXTERNAL, "entit"),
        "wrong namespace": ('<gml xmlns="http://example.org/gml"/>', "LandXML"),
        "NaN coordinate": (good.replace(f"{n + 200} {e}", f"NaN {e}"), "NaN|finite|number"),
        "missing coordinate": (good.replace(f"{n + 200} {e}", f"{n + 200}"), "coordinate|number|two"),
        "gap": (
            cli.document(cli.alignment(cli.line((0, 0), (0, 100)), cli.line((0, 100.5), (0, 200)))),
            "gap",
        ),
        "kink": (
            cli.document(cli.alignment(cli.line((0, 0), (0, 100)), cli.line((0, 100), (50, 150)))),
            "kink|turn|direction",
        ),
        "unknown EPSG": (good.replace("3879", "999999"), "999999"),
        "outside the system": (good.replace(f"{n}", "1234567").replace(f"{n + 200}", "1234767"), "outside|area"),
        "missing surface points": (
            cli.document(cli.surface(points, "<F>1 2 3</F><F>1 2 77</F>")),
            "77",
        ),
        "cant of metres in a millimetre file": (
            cli.document(cli.alignment(cli.STRAIGHT, rest=cant)),
            "cant",
        ),
    }


NAMES = [
    "not XML",
    "binary",
    "truncated",
    "empty",
    "bomb",
    "external entity",
    "wrong namespace",
    "NaN coordinate",
    "missing coordinate",
    "gap",
    "kink",
    "unknown EPSG",
    "outside the system",
    "missing surface points",
    "cant of metres in a millimetre file",
]


@pytest.mark.parametrize("name", NAMES)
def test_bad_site_files_in_every_command(cli, write: Callable[..., Path], tmp_path: Path, name: str) -> None:
    text, word = _bad_sites(cli)[name]
    path = write(text)
    for arguments in (
        ["site", path, "--json"],
        ["at", path, "--distance", 10, "--json"],
        ["limits", path, "--export", tmp_path / "x.glb", "--json"],
        ["run", "--site", path, "--at", f"{cli.E0},{cli.N0},0", "--headless", "--report", tmp_path / "r"],
    ):
        cli.refused(cli.workgauge(*arguments), "site.xml", word)
    assert [p.name for p in tmp_path.iterdir()] == ["site.xml"]


def test_missing_files_and_folders(cli, tmp_path: Path) -> None:
    cli.refused(cli.workgauge("site", tmp_path / "gone.xml"), "gone.xml")
    cli.refused(cli.workgauge("site", tmp_path), str(tmp_path))


def test_bad_machines(cli, shipped: Path, write: Callable[..., Path], tmp_path: Path) -> None:
    text = shipped_path("machines", "rre20.yaml").read_text()
    for bad, word in (
        (text.replace("size_m: [5.2, 2.5, 1.05]", "size_m: [5.2, 0, 1.05]"), "side without length"),
        (text.replace("lower_deg: -45\n    upper_deg: 65", "lower_deg: 65\n    upper_deg: -45"), "lower|upper|cross"),
        (text.replace("undercarriage:\n  kind", "undercarrage: 1\nundercarriage:\n  kind"), "undercarrage"),
    ):
        assert bad != text
        path = write(bad, "m.yaml")
        arguments = ["run", "--site", *sorted(shipped.glob("*.xml")), "--at", "25487284.7,6714592.3,42"]
        answer = cli.workgauge(*arguments, "--machine", path, "--report", tmp_path / "r")
        cli.refused(answer, "m.yaml", word)
        assert not (tmp_path / "r").exists()


def test_bad_scenarios(cli, write: Callable[..., Path], tmp_path: Path) -> None:
    path = write("title: x\nsite: {files: [gone.xml]}\nmachine: rre20\n", "s.yaml")
    cli.refused(cli.workgauge("run", "--scenario", path, "--report", tmp_path / "r"), "s.yaml", "required|missing")
    text = (
        "title: x\nsite:\n  files: [gone.xml]\nmachine: rre20\n"
        "start: {on_ground: {east_m: 0, north_m: 0, heading_deg: 0}}\ndrive: [{do: hold, for_s: 1}]\n"
    )
    path = write(text, "s.yaml")
    cli.refused(cli.workgauge("run", "--scenario", path, "--report", tmp_path / "r"), "s.yaml:3", "gone.xml")
    cli.refused(cli.workgauge("run", "--scenario", "no-such"), "no-such", "pole-approach")
    assert [p.name for p in tmp_path.iterdir()] == ["s.yaml"]


def test_a_start_inside_a_limit_names_limit_and_link(cli, write: Callable[..., Path], tmp_path: Path) -> None:
    site = write(cli.document(cli.alignment(cli.STRAIGHT, rest=cli.profile(50.0)), cli.POLE))
    at = f"{cli.E0 + 8},{cli.N0 + 101},0"
    answer = cli.workgauge("run", "--site", site, "--at", at, "--headless", "--report", tmp_path / "r")
    cli.refused(answer, "starts inside", "P7", "undercarriage|cabin")
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "--site", "x.xml"],
        ["run", "--at", "1,2,3"],
        ["run", "--site", "x.xml", "--at", "1,2"],
        ["run", "--site", "x.xml", "--at", "a,b,c"],
        ["run", "--site", "x.xml", "--at", "1,2,nan"],
        ["run", "--site", "x.xml", "--at", "1,2,3", "--scenario", "pole-approach"],
        ["run", "--scenario", "pole-approach", "--machine", "no-such-machine"],
        ["run", "--scenario", "pole-approach", "--rules", "no-such-rules"],
        ["run", "--nonsense"],
        ["site"],
        ["fly"],
    ],
)
def test_wrong_usage_is_exit_2_too(cli, arguments: list[str]) -> None:
    answer = cli.workgauge(*arguments)
    assert answer.code == 2
    assert answer.out == ""
    assert answer.err


def test_an_export_never_replaces_what_is_no_regular_file(cli, shipped: Path, tmp_path: Path) -> None:
    pipe, target, link = tmp_path / "pipe.glb", tmp_path / "target.glb", tmp_path / "link.glb"
    os.mkfifo(pipe)
    target.write_text("old")
    link.symlink_to(target)
    cli.refused(cli.workgauge("limits", shipped / "catenary.xml", "--export", pipe), "regular file")
    assert pipe.is_fifo()
    assert cli.workgauge("limits", shipped / "catenary.xml", "--export", link).code == 0
    assert link.is_symlink() and target.read_bytes()[:4] == b"glTF"
