"""`certify`: the documented object, the page, exit codes, going on where it was cut, two processes like one."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core import event

from workgauge.app import certify_command
from workgauge.app.output import COMPILING
from workgauge.rehearse.certify.outcome import certificate_id

COMMAND = ("certify", "--machine", "rre20", "--rules", "finland", "--dead-time", "0.3")
LINEAR = (*COMMAND, "--guard", "linear", "--drives", "6")


def afresh(*arguments: object) -> SimpleNamespace:
    """Run the command line in a process of its own: what this one has looked at before shows in the last digits."""
    program = [sys.executable, "-c", "from workgauge.app.cli import main; main()", *map(str, arguments)]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    return SimpleNamespace(code=done.returncode, out=done.stdout, err=done.stderr)


@pytest.fixture(scope="module")
def failed(cli, tmp_path_factory):  # type: ignore[no-untyped-def]
    """Linear scaling on a machine that stops late, with its journal."""
    folder = tmp_path_factory.mktemp("certificate")
    journal = folder / "drives.jsonl"
    return cli.workgauge(*LINEAR, "--jobs", 1, "--journal", journal, "--json"), journal


def test_exactly_the_documented_object_and_exit_code_3(failed) -> None:  # type: ignore[no-untyped-def]
    answer, _ = failed
    assert answer.code == 3
    data = json.loads(answer.out)
    assert list(data) == [
        *("id", "machine", "passed", "drives", "entries", "below_stop", "worst_clearance_m", "worst_less_stop_m"),
        *(
            "worst",
            "failed",
            "failing_share_at_most",
            "motion_share",
            "time_lost_share",
            "linear",
            "edges_m",
            "counts",
        ),
        *(
            "conditions",
            "places",
            "on_site",
            "undriven",
            "results_sha256",
            "drives_wanted",
            "dead_times_s",
            "stopping",
        ),
        *("warnings", "fingerprint"),
    ]
    assert data["id"] == certificate_id(data) and data["passed"] is False and data["below_stop"] > 0
    assert data["drives"] == data["drives_wanted"] == 6 and data["dead_times_s"] == [0.3]
    assert [one["condition"] for one in data["conditions"]] == [
        *("tolerance", "ends", "late bus", "missed ticks", "+0.3 s")
    ]
    assert sum(one["drives"] for one in data["conditions"] if one["within_model"]) == 6
    assert list(data["fingerprint"]) == [
        *("machine", "rule book", "site", "guard", "drives", "seed", "program", "libraries")
    ]
    assert any("to be confirmed" in one for one in data["warnings"])
    assert "to be confirmed" in answer.err and "8 of 8 drives" in answer.err


@pytest.mark.prove
def test_two_processes_give_the_same_and_so_does_a_journal_cut_in_the_middle(cli, tmp_path) -> None:  # type: ignore[no-untyped-def]
    journal = tmp_path / "whole.jsonl"
    answer = afresh(*LINEAR, "--jobs", 1, "--journal", journal, "--json")
    whole = journal.read_bytes().splitlines(keepends=True)
    assert len(whole) == 9
    cut = tmp_path / "drives.jsonl"
    cut.write_bytes(b"".join(whole[:3]) + whole[3][:100])
    again = afresh(*LINEAR, "--jobs", 2, "--journal", cut, "--json")
    assert (again.code, again.out) == (3, answer.out)
    assert "2 of 8 drives are in the journal" in again.err
    assert sorted(line for line in cut.read_bytes().splitlines(keepends=True) if len(line) != 101) == sorted(whole)
    more = cli.workgauge(*LINEAR[:-1], "5", "--jobs", 1, "--journal", cut, "--json")  # all of them are known
    assert json.loads(more.out)["drives"] == 5


def test_passed_with_a_page_to_sign(cli, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder = tmp_path / "out"
    arguments = (*COMMAND, "--drives", 2, "--seed", 3, "--report", folder, "--jobs", 1)
    answer = cli.workgauge(*arguments)
    assert answer.code == 0, answer.err
    assert "Passed" in answer.out and "beyond the model" in answer.out and "not a certified safety" in answer.out
    assert sorted(one.name for one in folder.iterdir()) == ["certificate.html", "certificate.json", "drives.jsonl"]
    page, data = (folder / "certificate.html").read_text(), json.loads((folder / "certificate.json").read_text())
    assert data["passed"] and data["id"] == certificate_id(data) and data["id"] in page
    for words in (
        "Signature",
        "not a certified safety function",
        "Beyond the model",
        "As long as",
        "to be confirmed",
    ):
        assert words in page
    assert "<svg" in page and "http" not in page.replace("http://www.w3.org", "") and "<script" not in page
    assert data["fingerprint"]["machine"]["sha256"] in page and "workgauge certify --machine rre20" in page
    once_more = cli.workgauge(*arguments, "--json")
    assert once_more.code == 0 and json.loads(once_more.out) == data


def test_an_interrupt_keeps_what_is_done_and_says_how_to_go_on(cli, failed, tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    answer, journal = failed
    real = certify_command.driven
    lines = journal.read_bytes().splitlines(keepends=True)
    path = tmp_path / "drives.jsonl"
    path.write_bytes(b"".join(lines[:8]))

    def interrupted(*arguments):  # type: ignore[no-untyped-def]
        yield from real(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(certify_command, "driven", interrupted)
    stopped = cli.workgauge(*LINEAR, "--journal", path, "--jobs", 1, "--json")
    assert stopped.code == 130 and stopped.out == ""
    assert "the same command again goes on" in stopped.err and str(path) in stopped.err
    monkeypatch.undo()
    assert cli.workgauge(*LINEAR, "--journal", path, "--jobs", 1, "--json").out == answer.out


def test_what_is_compiled_first_is_said(capsys) -> None:  # type: ignore[no-untyped-def]
    with certify_command._progress(4, 0) as say:
        for status in (event.EventStatus.START, event.EventStatus.END, event.EventStatus.START):
            event.broadcast(event.Event("numba:compile", status))
        say(1, 0)
    assert capsys.readouterr() == ("", f"{COMPILING}\n1 of 4 drives, 0 failed\n")


def test_what_cannot_be_used_is_refused(cli, failed, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    _, journal = failed
    kept = journal.read_bytes()
    with_journal = ("--journal", journal)
    cli.refused(cli.workgauge(*LINEAR, "--seed", 1, *with_journal), "another certificate", "seed")
    cli.refused(cli.workgauge(*LINEAR, "--machine", "brokk5", *with_journal), "another certificate", "machine")
    cli.refused(cli.workgauge(*LINEAR, "--guard", "barrier", *with_journal), "another certificate", "guard")
    cli.refused(cli.workgauge(*LINEAR, "--rules", "germany", *with_journal), "another certificate", "rule book")
    assert journal.read_bytes() == kept
    cli.refused(cli.workgauge(*LINEAR, "--journal", tmp_path), "journal cannot be read")
    cli.refused(cli.workgauge(*LINEAR, "--guard", "asleep"), "unknown guard")
    cli.refused(cli.workgauge(*LINEAR, "--dead-time", "0"), "--dead-time", "out of range")
    cli.refused(cli.workgauge(*LINEAR, "--machine", "rre99"), "unknown machine")
    cli.refused(cli.workgauge(*LINEAR, "--site", tmp_path / "no.xml"), "no.xml")
    assert cli.workgauge("certify", "--machine", "rre20").code == 2
